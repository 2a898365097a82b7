"""The scenes and parameters whose derivative pictures are compared, and what the comparison is made with."""

import dataclasses
import pathlib

HERE = pathlib.Path(__file__).resolve().parent


@dataclasses.dataclass(frozen=True)
class Case:
    """One scene at one size.

    Args:
        name: for files and tables.
        path: the scene.
        size: (width, height) of the picture.
        samples: rays a pixel in each direction of the reference's point-sampled pictures.
        steps: for each scalar parameter how far it moves to either side in the reference.
        moved: the parameters of the moved scene whose picture the loss compares with.
    """

    name: str
    path: pathlib.Path
    size: tuple[int, int]
    samples: int
    steps: dict[str, float]
    moved: dict[str, float]


def sized(case: Case, size: tuple[int, int]) -> Case:
    """The case at another size, by steps of as many samples."""
    longer = case.size[0] / size[0]
    return dataclasses.replace(case, size=size, steps={name: step * longer for name, step in case.steps.items()})


def glass_ball(ball: str, ior_step: float, z_step: float = 2e-3) -> dict[str, float]:
    """Index, position and radius of one ball, and one coordinate each of a light and of the viewpoint.

    A step is good where the difference of two grids of samples is: edges should move by several samples, also those
    that lie along a column of the grid, as the line where the walls meet does, and by much less than a pixel.
    """
    return {
        f"{ball}.ior": ior_step,
        f"{ball}.center.x": 2e-3,
        f"{ball}.center.y": 2e-3,
        f"{ball}.center.z": z_step,
        f"{ball}.radius": 2e-3,
        "topright.location.x": 2e-3,
        "cam1.viewpoint.x": 1.6e-2,
    }


ASSIGNMENT = HERE.parent.parent / "data" / "vitreous.txt"
MOVED = {"vitreous.ior": 1.36, "vitreous.center.x": 4.2, "vitreous.center.y": 2.4, "vitreous.center.z": -1.1}

CASES = (
    Case("assignment", ASSIGNMENT, (160, 120), 48, glass_ball("vitreous", 6e-4), MOVED),
    Case("assignment, 320x240", ASSIGNMENT, (320, 240), 24, glass_ball("vitreous", 6e-4), MOVED),
    Case(
        "two balls",
        HERE / "scenes" / "two_balls.txt",
        (160, 120),
        32,
        glass_ball("near", 2e-3, 4e-3),
        {"near.ior": 1.53, "near.center.x": 2.8, "near.center.y": 2.5, "near.center.z": -1.3},
    ),
    Case(
        "bubble in glass",
        HERE / "scenes" / "bubble.txt",
        (160, 120),
        32,
        glass_ball("glass", 2e-3, 4e-3),
        {"glass.ior": 1.53, "glass.center.x": 3.9, "glass.center.y": 2.9, "glass.center.z": -1.9},
    ),
    Case(
        "glass plate",
        HERE / "scenes" / "plate.txt",
        (160, 120),
        32,
        {"pane.ior": 8e-3, **{name: step for name, step in glass_ball("ball", 0, 8e-3).items() if name != "ball.ior"}},
        {"pane.ior": 1.53, "ball.center.x": 3.3, "ball.center.y": 2.7, "ball.center.z": -4.1},
    ),
    Case(
        "glass before a checker",
        HERE / "scenes" / "checker.txt",
        (160, 120),
        24,
        {
            "ball0.ior": 4e-3,
            "ball0.center.x": 2e-3,
            "ball0.center.y": 2e-3,
            "ball0.center.z": 1.6e-2,
            "ball0.radius": 8e-3,
            "backdrop.center.z": 3.2e-2,
            "eye.fov": 0.2,
            "ball0.absorption.g": 0.02,
        },
        {"ball0.ior": 1.42, "ball0.center.x": 0.02, "ball0.center.y": -0.02, "ball0.center.z": 0.02},
    ),
)
