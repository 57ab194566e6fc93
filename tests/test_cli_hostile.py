"""Whatever the command is given: no traceback, a documented status, nothing littered.

Under the tests that stand in, so that nothing is compiled.
"""

import contextlib
import io
import json
import os
import sys
import warnings
from pathlib import Path

import pytest

pytest.importorskip("hypothesis")

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jaxbe.cli import main
from jaxbe.viz import picture
from tests import hostile

SCENE = b"""<mujoco><worldbody><geom type="box" size="1 1 1"/>
<body><joint type="slide"/><geom type="ellipsoid" size="1 1 1"/></body>
</worldbody></mujoco>"""

SMALL = settings(
    max_examples=150,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
LONG = settings(SMALL, max_examples=5000, derandomize=False)


@pytest.fixture(autouse=True)
def quick(stand_in_tests, monkeypatch, tmp_path):
    """Nothing is compiled, and no process started to draw."""

    def render(view, path, backend):
        path.write_bytes(b"a picture")

    monkeypatch.setattr(picture, "_render", render)
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    Path("folder.png").mkdir()
    Path("old.png").write_bytes(b"older")
    Path("link.png").symlink_to("folder/new.png")
    Path("loop.png").symlink_to("loop.png")
    Path("linked.png").symlink_to("scene.xml")
    os.mkfifo("pipe.png")


class Standard(io.TextIOWrapper):
    """A stream that encodes strictly, and gives what was written."""

    def __init__(self, encoding):
        super().__init__(io.BytesIO(), encoding=encoding, newline="\n")

    def text(self):
        self.flush()
        return self.buffer.getvalue().decode(self.encoding)


def run(arguments, encoding="utf-8"):
    """Status, output, errors, and whether it was help or version.

    NumPy's warnings would be lines among the errors: they are none.
    """
    out, err = Standard(encoding), Standard("utf-8")
    err.reconfigure(errors="backslashreplace")
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(action="error", category=RuntimeWarning),
    ):
        try:
            status, is_help = main(arguments), False
        except SystemExit as stop:
            status, is_help = stop.code, True
    return status, out.text(), err.text(), is_help


def contents():
    """Every file of the current folder with its content, without following links."""
    found = {}
    for path in Path().rglob("*"):
        is_file = path.is_file() and not path.is_symlink()
        kind = os.readlink(path) if path.is_symlink() else path.lstat().st_mode
        found[str(path)] = path.read_bytes() if is_file else kind
    return found


def check(arguments, encoding="utf-8"):
    """Runs, and holds it to all that is promised."""
    before = contents()
    status, out, err, is_help = run(arguments, encoding)
    assert status in (0, 1, 2), err
    assert out.replace("\n", "").isprintable()
    lines = err.splitlines()
    assert all(line.startswith("jaxbe: ") and line.isprintable() for line in lines)
    errors = [x for x in lines if not x.startswith("jaxbe: warning: MuJoCo: ")]
    assert len(errors) == (status == 2), err
    if is_help:
        assert status == 0
        assert out.startswith(("usage: jaxbe ", "jaxbe "))
    elif "--json" in arguments and status < 2:
        json.loads(out)
    after = contents()
    changed = {x for x in before | after if before.get(x) != after.get(x)}
    for name in changed:
        assert status < 2
        assert after.pop(name) == b"a picture"
        Path(name).unlink()
    assert len(changed) <= ("--picture" in arguments)
    if "old.png" in changed:
        Path("old.png").write_bytes(b"older")
    return status


def write(scene=SCENE, states=b""):
    Path("scene.xml").write_bytes(scene)
    Path("states.npy").write_bytes(states)


def check_arguments(arguments, states, encoding):
    write(states=states)
    check(arguments, encoding)


def check_scene(scene, arguments, encoding):
    write(scene)
    check(["scene.xml", *arguments], encoding)


def check_states(content):
    write(states=content)
    check(["scene.xml", "--qpos", "states.npy", "--sample", "0"])


ENCODINGS = st.sampled_from(["utf-8", "ascii", "latin-1", "utf-16"])
SHORT = st.sampled_from(
    [["--states", "2", "--sample", x, *more] for x in "02" for more in ([], ["--json"])]
)
ANY_ARGUMENTS = given(hostile.arguments(), hostile.states(), ENCODINGS)
ANY_SCENE = given(hostile.scenes(), SHORT, ENCODINGS)
ANY_STATES = given(hostile.states())


@pytest.mark.parametrize(
    ("strategy", "function"),
    [
        (ANY_ARGUMENTS, check_arguments),
        (ANY_SCENE, check_scene),
        (ANY_STATES, check_states),
    ],
)
def test_hostile_input(strategy, function):
    SMALL(strategy(function))()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strategy", "function"),
    [
        (ANY_ARGUMENTS, check_arguments),
        (ANY_SCENE, check_scene),
        (ANY_STATES, check_states),
    ],
)
def test_much_hostile_input(strategy, function):
    LONG(strategy(function))()


@pytest.mark.slow
@LONG
@given(hostile.scenes().flatmap(hostile.damaged))
def test_damaged_scenes(scene):
    check_scene(scene, ["--states", "2", "--sample", "2"], "utf-8")


def test_most_of_it_gets_as_far_as_the_report():
    """Else the rest would test little."""
    reached = []

    def count(scene, arguments):
        write(scene)
        reached.append(check(["scene.xml", *arguments]) < 2)

    SMALL(given(hostile.scenes(), SHORT)(count))()
    assert sum(reached) > len(reached) / 4


@pytest.mark.skipif(sys.platform != "linux", reason="of what Linux takes as a name")
@pytest.mark.parametrize("name", ["\udcff", "\x1b[31m", "a\nb", "-x", "%s", "x" * 200])
def test_names_of_scenes(name):
    write()
    Path(name).write_bytes(SCENE)
    check(["--states", "2", "--sample", "2", "--", name])
    Path(name).write_bytes(b"")
    check(["--json", "--", name])
