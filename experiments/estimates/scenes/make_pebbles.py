"""Write pebbles.txt: a glass ball before a wall of 63 small spheres in two colours, set like a checker board.

    python experiments/estimates/scenes/make_pebbles.py [FILE]

Without a FILE it is the one beside this script.
"""

import sys
from pathlib import Path

HEADER = """camera camera1 { pixeldim 160 120 worlddim 8 6 viewpoint 4 3 6 }
light above { location 6 9 6 emissivity 4 4 4 }
light left { location -3 3 5 emissivity 3 3 3 }
material wall { ambient .1 .11 .13 diffuse .15 .17 .2 }
material bright { ambient .35 .3 .15 diffuse .8 .7 .4 }
material dark { ambient .05 .08 .3 diffuse .2 .25 .6 }
material glass { ambient 0 0 0 diffuse .02 .02 .02 specular .9 .9 .9 alpha .9 ior 1.5 }
plane back { material wall normal 0 0 1 point 4 3 -6 }
"""


def main() -> None:
    """The command."""
    lines = [HEADER, "sphere ball { material glass center 4 3 -1 radius 1.3 }"]
    for row in range(7):
        for column in range(9):
            material = "bright" if (row + column) % 2 else "dark"
            center = f"{1.2 + 0.7 * column:.1f} {0.9 + 0.7 * row:.1f} -5.5"
            lines.append(f"sphere pebble{row}{column} {{ material {material} center {center} radius .33 }}")
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("pebbles.txt")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
