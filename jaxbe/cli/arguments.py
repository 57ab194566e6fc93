"""The arguments of the command line."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NoReturn

from jaxbe import __version__
from jaxbe.cli.errors import InputError
from jaxbe.cli.output import write
from jaxbe.cli.shown import shown

DEFAULT_SCENE = Path(__file__).parents[1] / "scenes" / "arm_and_shelf.xml"
DEFAULT_STATES = 1000

MOST_DIGITS = 100
"""Of numbers: enough for any seed, and what Python turns into text."""

DESCRIPTION = """\
Which boxes and ellipsoids of a MuJoCo scene overlap, over many states?

Finds the box-ellipsoid pairs that the scene lets collide, draws random states
inside the joint ranges (or reads them from a file), and runs the three exact
tests of jaxbe on every pair in every state. Checks the three against each other
and, on a sample, against MuJoCo's own mj_geomDistance. Also gives, of every pair,
  signed distance  metres: the distance apart, minus the depth overlapping
  margin           the factor by which both bodies must grow to touch, minus one
                   (both are negative where they overlap, 0 where they touch)
  certified        in how many states it is proved, for the very floats tested, that
                   the pair overlaps (+), that it does not (-), or neither (?)
Without SCENE.xml it runs on the scene that ships with jaxbe: an arm, a table and a
shelf. Some ten seconds go into compiling, most of them for the distance.
"""

EPILOG = """\
how states are drawn:
  hinge, slide   uniform in the range; a full turn, or the scene's extent either
                 way, where there is none
  ball           any rotation; up to the limit about a random axis where there is one
  free           a box of the scene's extent around the start, any rotation
  Equality constraints are not enforced, and mocap bodies stay where they are.
  A seed gives the same states whatever the batch.

what counts as disagreement:
  Between the three tests: different answers although scaled_distance differs from
  1 by more than rounding (float32: 1e-5 where the longest length is to 40 times
  the smallest semi-axis, 1e-4 to 1000 times; float64: 1e-12 and 1e-10).
  Certificates and the sign of the distance with the tests: a verdict that is proved
  and contradicts a test, or a sign that does, likewise by more than rounding.
  Not compared: undecided verdicts, and pairs whose distances are NaN.
  With MuJoCo C: different answers although MuJoCo's distance differs from 0 by
  more than its ccd_tolerance plus what rounding can move the bodies.
  The sample is half pairs that overlap, half that do not, near ones preferred.

exit status:
  0  fine
  1  the tests disagree among themselves, with certificates, with the sign of the
     distance or with MuJoCo C
  2  bad input, said in one line on standard error
  3  the unexpected, in such a line too: standard output that cannot be written, or a
     fault of jaxbe
  130  interrupted by Ctrl-C
  With 2, 3 and 130 what was found before is printed nevertheless, but for the states of
  a sweep that is interrupted; "agree" is not true.

examples:
  jaxbe                                       the scene that ships with jaxbe
  jaxbe robot.xml --states 100000             a scene of yours
  jaxbe robot.xml --geoms palm left_finger    only pairs with these geoms
  jaxbe robot.xml --qpos run.npy              your states, an array (N, nq)
  jaxbe robot.xml --picture overlap.png       and look at one that overlaps
  jaxbe robot.xml --json | jq .pairs          for machines
"""


@dataclasses.dataclass(frozen=True)
class Options:
    """The parsed arguments; see `--help` for each."""

    scene: Path
    states: int
    seed: int
    qpos: Path | None
    dtype: Literal["float32", "float64"]
    sample: int
    batch: int | None
    geoms: list[str] | None
    rows: int
    json: bool
    picture: Path | None


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line, instead of the usage and a line."""
        raise InputError(f"{shown(message)} (see jaxbe --help)")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Help and version; argparse would not notice that nobody got them."""
        write(message)


def parse(argv: Sequence[str] | None = None) -> Options:
    """Parses the arguments.

    Raises:
        InputError: an argument that is not understood.
        SystemExit: after `--help` and `--version`, with status 0.
    """
    return Options(**vars(_parser().parse_args(argv)))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="jaxbe",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"jaxbe {__version__}")
    _add_input(parser)
    _add_computation(parser)
    _add_output(parser)
    return parser


def _add_input(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("input")
    group.add_argument(
        "scene",
        metavar="SCENE.xml",
        nargs="?",
        type=Path,
        default=DEFAULT_SCENE,
        help="a MuJoCo model in MJCF or URDF (default: the scene shipped with jaxbe)",
    )
    group.add_argument(
        "--geoms",
        metavar="NAME",
        nargs="+",
        help="only pairs in which at least one of these geoms takes part",
    )
    states = group.add_mutually_exclusive_group()
    states.add_argument(
        "--states",
        metavar="N",
        type=_positive,
        default=DEFAULT_STATES,
        help="how many random states to draw (default: %(default)s)",
    )
    states.add_argument(
        "--qpos",
        metavar="FILE.npy",
        type=Path,
        help="states to use instead: an array (N, nq) or (nq,) of MuJoCo's qpos",
    )
    group.add_argument(
        "--seed",
        metavar="N",
        type=_not_negative,
        default=0,
        help="of the random states and the sample (default: %(default)s)",
    )


def _add_computation(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("computation")
    group.add_argument(
        "--dtype",
        choices=("float32", "float64"),
        default="float32",
        help="what the tests compute in (default: %(default)s, as MJX does)",
    )
    group.add_argument(
        "--sample",
        metavar="N",
        type=_not_negative,
        default=1000,
        help="how many pairs, each in some state, to check against MuJoCo C "
        "(default: %(default)s; 0: none)",
    )
    group.add_argument(
        "--batch",
        metavar="N",
        type=_positive,
        help="states at a time (default: about 250 000 pairs at a time); memory "
        "grows with it and not with --states",
    )


def _add_output(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("output")
    group.add_argument(
        "--rows",
        metavar="N",
        type=_not_negative,
        default=20,
        help="how many pairs to print, those that overlap most often first "
        "(default: %(default)s; --json has all)",
    )
    group.add_argument("--json", action="store_true", help="one JSON object instead")
    group.add_argument(
        "--picture",
        metavar="OUT.png",
        type=Path,
        help="draw the state of the smallest margin, the deepest overlap by the size "
        "of the pair or the nearest miss, with witness points and the normal from "
        "ellipsoid to box: rendered by MuJoCo where OpenGL works (MUJOCO_GL is "
        "respected), else plotted",
    )


def _positive(text: str) -> int:
    if (number := _not_negative(text)) == 0:
        raise argparse.ArgumentTypeError("must be at least 1, got 0")
    return number


def _not_negative(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a whole number, got {text!r}")
    if len(text) > MOST_DIGITS:
        raise argparse.ArgumentTypeError(f"must have at most {MOST_DIGITS} digits")
    return int(text)
