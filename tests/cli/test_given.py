"""What callers give from Python and is of another type than is wanted: told in a sentence, with what to write."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from scenes import DATA

from raytrace_jax import FitOptions

CALLS = {
    "render": "rj.render({}, {})",
    "picture_derivatives": "rj.picture_derivatives({}, FREE, {})",
    "fit": "rj.fit({}, TARGET, FREE, {})",
    "make_residual": "rj.make_residual({}, TARGET, FREE, {})",
}

WRONG = {
    **{
        call.format("'guess.txt'", None): "SceneError: a scene is wanted, and this is the text 'guess.txt': load it "
        "with load_scene('guess.txt')."
        for call in CALLS.values()
    },
    **{
        call.format(
            "scene", {"samples": 2}
        ): "SettingsError: RenderSettings are wanted, and this is {'samples': 2}: write RenderSettings(samples=2)."
        for call in CALLS.values()
    },
    "rj.render('a.txt', SMALL)": "load_scene('a.txt')",
    "rj.render(scene, 3)": "SettingsError: RenderSettings are wanted, and this is 3: write RenderSettings(...).",
    "rj.list_parameters('a.txt')": "load_scene('a.txt')",
    "rj.set_parameters('a.txt', {})": "load_scene('a.txt')",
    "rj.format_scene('a.txt')": "load_scene('a.txt')",
    "rj.export_scene('a.txt', 'b.xml', 'mitsuba')": "load_scene('a.txt')",
    "rj.render('camera eye { }')": "read it with parse_scene",
    "rj.render(pathlib.Path('a.txt'))": "load_scene('a.txt')",
    "rj.render(None)": "SceneError: a scene is wanted, as load_scene and make_scene return it, and this is of the type "
    "NoneType.",
    "rj.fit(scene, TARGET, 'vitreous.ior', SMALL)": "ParameterError: a list of names is wanted, and this is the text "
    "'vitreous.ior': write ['vitreous.ior'].",
    "rj.fit(scene, TARGET, 'vitreous.ior', SMALL, options=rj.FitOptions(fit_exposure=True))": "write ['vitreous.ior'].",
    "rj.fit(scene, TARGET, FREE, SMALL, options={'sigma': 1})": "ParameterError: FitOptions are wanted, and this is "
    "{'sigma': 1}: write FitOptions(sigma=1).",
    "rj.fit(scene, TARGET, FREE, SMALL, options=SMALL)": "ParameterError: FitOptions are wanted, and this is Render",
    "rj.make_residual(scene, TARGET, 'vitreous.ior', SMALL)": "write ['vitreous.ior'].",
    "rj.picture_derivatives(scene, 'vitreous.ior', SMALL)": "write ['vitreous.ior'].",
    "rj.fit(scene, TARGET, [3], SMALL)": "ParameterError: the name of a parameter is wanted, such as 'glass.ior', and "
    "this is 3.",
    "rj.FitOptions(priors={'vitreous.ior': 1.5})": "ParameterError: priors is {'vitreous.ior': 1.5}; "
    "wanted (mean, standard deviation) by name",
}
"""What is called, and what is answered."""

PROGRAM = """
import json, pathlib, sys
import numpy as np
import raytrace_jax as rj

scene, FREE = rj.load_scene(sys.argv[1]), ["vitreous.ior"]
SMALL = rj.RenderSettings(size=(24, 18), max_bounces=0, edges="point")
TARGET = np.linspace(0, 1, 3 * 18 * 24).reshape(3, 18, 24)
answers = []
for call in json.load(sys.stdin):
    try:
        answers.append(f"no error: {eval(call)}")
    except Exception as error:
        answers.append(f"{type(error).__name__}: {error}")
print(json.dumps(answers))
"""


@pytest.fixture(scope="module")
def answers():
    """Of a process of its own: here beartype would refuse the calls before the package does."""
    command = [sys.executable, "-c", PROGRAM, str(DATA / "vitreous.txt")]
    ended = subprocess.run(command, input=json.dumps(list(WRONG)), capture_output=True, text=True, env=os.environ)
    assert ended.returncode == 0, ended.stderr
    return dict(zip(WRONG, json.loads(ended.stdout), strict=True))


@pytest.mark.parametrize("call", WRONG)
def test_what_is_wanted_is_said(call, answers):
    assert WRONG[call] in answers[call]


def test_numpy_numbers_are_numbers():
    options = {"sigma": np.float32(0.1), "blur": np.array([2.0, 1.0]), "max_steps": np.int64(3)}
    known = {"ball.ior": (np.float64(1.5), np.float64(0.1))}
    FitOptions(**options, priors=known, uncertain={"cam1": "1%", "lights": np.float64(2)})
