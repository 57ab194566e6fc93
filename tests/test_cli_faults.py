"""What may go wrong around the command: names, files, streams, memory, interrupts."""

import contextlib
import io
import json
import os
import re
import stat
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import jaxbe
from jaxbe.cli import job, main
from jaxbe.cli.memory import BYTES_PER_PAIR
from jaxbe.cli.scene import labels
from jaxbe.mjx import find_pairs
from jaxbe.mjx.pairs import geom_names
from jaxbe.viz import picture
from jaxbe.viz.view import View

pytestmark = pytest.mark.usefixtures("stand_in_tests")

FEW = ["--states", "5", "--sample", "0"]
COMPARED = [*FEW, "--sample", "4"]
"""MuJoCo C contradicts the tests that stand in."""

ODD = b"od\xff\x1b[31m\n\xe2\x80\xae"
"""Bytes that are not UTF-8, a terminal's command, a new line, right to left."""

ODD_SHOWN = r"od\udcff\x1b[31m\n\u202e"


def scene_bytes(hand=b"hand", tool=b"tool", extra=b""):
    return b"""<mujoco>%s<worldbody>
      <geom name="shelf" type="box" size=".5 .4 .02" pos="0 0 .3"/>
      <body name="%s"><joint type="slide" axis="0 0 1" range="0 1"/>
        <geom name="%s" type="ellipsoid" size=".1 .2 .3"/>
        <geom type="ellipsoid" size=".1 .1 .1" pos="0 0 .1"/>
      </body></worldbody></mujoco>""" % (extra, tool, hand.replace(b"\n", b"&#10;"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, and empty but for a scene."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.xml").write_bytes(scene_bytes())
    return tmp_path


@pytest.fixture
def run(capsys):
    """Runs to a status; returns what was printed, and the one line of an error."""

    def run(status, *arguments):
        assert main([*arguments]) == status
        out, err = capsys.readouterr()
        assert err.count("\n") == (status > 1)
        assert not err or err.startswith("jaxbe: ")
        assert err.rstrip("\n").isprintable()
        return out, err.removeprefix("jaxbe: ").rstrip("\n")

    return run


# Names.


def test_names_that_are_not_utf8_are_kept_and_found(folder):
    (folder / "odd.xml").write_bytes(scene_bytes(ODD, b"t\xfe"))
    model = mujoco.MjModel.from_xml_path("odd.xml")
    names = geom_names(model)
    assert names[1].encode(errors="surrogateescape") == ODD
    assert names[1] == os.fsdecode(ODD), "as in sys.argv"
    assert len(find_pairs(model, [names[1]])) == 1
    assert labels(model)[2] == "t\udcfe/geom2"


def test_two_names_that_are_not_utf8_stay_two(folder):
    """Replacement characters would make them one."""
    (folder / "odd.xml").write_bytes(scene_bytes(b"\xfe").replace(b"shelf", b"\xff"))
    model = mujoco.MjModel.from_xml_path("odd.xml")
    assert geom_names(model)[:2] == ["\udcff", "\udcfe"]


def test_names_are_shown_escaped_and_are_themselves_in_json(folder, run, monkeypatch):
    (folder / "odd.xml").write_bytes(scene_bytes(ODD))
    monkeypatch.setenv("COLUMNS", "200")
    out, _ = run(1, "odd.xml", *COMPARED, "--geoms", os.fsdecode(ODD))
    assert out.replace("\n", "").isprintable()
    assert f", {ODD_SHOWN} and shelf: scaled distance" in out, "disagreements"
    assert f"{ODD_SHOWN} and shelf, distance" in out, "the deepest"
    assert out.count(ODD_SHOWN) >= 3, "the table too"
    out, _ = run(1, "odd.xml", *COMPARED, "--json")
    assert json.loads(out)["pairs"][0]["ellipsoid"] == os.fsdecode(ODD)
    _, error = run(2, "scene.xml", "--geoms", os.fsdecode(ODD))
    assert ODD_SHOWN in error


def test_emoji_codes_in_names_stay_codes(folder, run):
    (folder / "odd.xml").write_bytes(scene_bytes(b"a:smile:b [red]c"))
    assert "a:smile:b [red]c" in run(0, "odd.xml", *FEW)[0]


def test_names_of_geoms_without_pairs_are_escaped(folder, run):
    (folder / "odd.xml").write_bytes(
        scene_bytes().replace(
            b"<body", b'<geom name="\x1b&#10;" size=".1" pos="3 0 0"/><body'
        )
    )
    _, error = run(2, "odd.xml", "--geoms", "\x1b\n")
    assert r"no box-ellipsoid pair with \x1b\n that" in error


def test_what_mujoco_quotes_is_escaped(folder, run):
    (folder / "odd.xml").write_bytes(
        scene_bytes().replace(b'"box"', b'"b\xff\x1b[31m"')
    )
    _, error = run(2, "odd.xml")
    assert r"invalid keyword: 'b\udcff\x1b[31m'" in error


def test_long_messages_are_cut(folder, run):
    (folder / "odd.xml").write_bytes(scene_bytes().replace(b"box", b"b" * 20_000))
    assert len(run(2, "odd.xml")[1]) < 2000


# Files to read.


@pytest.mark.skipif(os.name == "nt", reason="names are UTF-16 there")
def test_names_of_files_need_not_be_utf8(folder, run, monkeypatch):
    scene, states, out = (os.fsdecode(b"\xff\x1b" + x) for x in (b".x", b".n", b".png"))
    Path(scene).write_bytes(scene_bytes())
    with Path(states).open("wb") as file:
        np.save(file, np.zeros((3, 1)))
    monkeypatch.setattr(picture, "_backends", list)  # Plots.
    arguments = [scene, "--qpos", states, "--picture", out, "--sample", "0"]
    text, _ = run(0, *arguments)
    assert text.startswith(r"\udcff\x1b.x" + "\n")
    assert r"drawn by matplotlib (MuJoCo could not render: ): \udcff\x1b.png" in text
    report = json.loads(run(0, *arguments, "--json")[0])
    assert (report["scene"], report["qpos"]) == (scene, states)
    assert Path(out).read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(os.name == "nt", reason="names are UTF-16 there")
def test_the_renderer_reads_scenes_whose_names_are_not_utf8(folder):
    """Up to OpenGL, which need not be there."""
    from jaxbe.viz.offscreen import _load

    name = os.fsdecode(b"\xff.xml")
    Path(name).write_bytes(scene_bytes())
    assert _load(name).ngeom == 3


@pytest.mark.parametrize("option", [(), ("scene.xml", "--qpos")])
def test_what_is_not_a_file_is_named_so(folder, run, option):
    Path("a folder").mkdir()
    os.mkfifo("pipe")
    Path("loop").symlink_to("loop")
    for path, words in {
        "missing": "no such file: missing",
        "scene.xml/missing": "no such file: scene.xml/missing",
        "new\nline": r"no such file: new\nline",
        "a folder": "a folder is a directory, not a file",
        "pipe": "pipe is not a regular file",
        os.devnull: f"{os.devnull} is not a regular file",
        "loop": "cannot read loop: Too many levels of symbolic links",
        "x" * 5000: "File name too long",
    }.items():
        assert words in run(2, *option, path)[1]


def npy(header, version=b"\x01\x00", body=b"\0" * 64):
    length = len(header).to_bytes(2 if version[0] == 1 else 4, "little")
    return b"\x93NUMPY" + version + length + header + body


FORM = b"{'descr': '<f8', 'fortran_order': False, 'shape': %s, }"


@pytest.mark.parametrize(
    "content",
    [
        npy(FORM % b"(99999999999999999999999, 1)"),
        npy(FORM % b"(9223372036854775807, 1)"),
        npy(FORM % b"(4611686018427387904, 4)"),
        npy(FORM % b"(-1, 1)"),
        npy(FORM % b"(1e3, 1)"),
        npy(FORM % b"(True, 1)"),
        npy(FORM % b"(('a', 1), 1)"),
        npy(FORM % (b"(" * 3000)),
        npy(b"{" * 20_000),
        npy(b"{'descr'"),
        npy(b"'\\d'"),
        npy(b"{'descr': '\\N{x}'"),
        npy(b"\0\0"),
        npy(b"1L"),
        npy(b"{'descr': [('a', '<f8'], 'fortran_order': 0, 'shape': ()}"),
        npy((FORM % b"(1, 1)").replace(b"<f8", b"<f99")),
        npy((FORM % b"(1, 1)").replace(b"'<f8'", b"('<f8', (1, -1))")),
        npy((FORM % b"(1, 1)").replace(b"<f8", b"|O")),
        npy((FORM % b"(1, 1)").replace(b"<f8", b"<M8[\x1b]")),
        npy(b"\xff\xfe", version=b"\x03\x00"),
        npy(b"{}", version=b"\x09\x09"),
        npy(FORM % b"(1000, 1)"),
        b"\x93NUMPY",
        b"\x93NUMPY\x01\x00\xff\xff",
        b"PK\x03\x04",
        b"\x80\x04N.",
    ],
)
def test_headers_that_are_broken(folder, run, content):
    Path("x.npy").write_bytes(content)
    _, error = run(2, "scene.xml", "--qpos", "x.npy")
    assert "x.npy is not an .npy file of numbers: " in error or "must " in error


@pytest.mark.parametrize("content", [scene_bytes(), b"\x80\x04N........."])
def test_nobody_is_advised_to_load_unsafely(folder, run, content):
    Path("x.npy").write_bytes(content)
    _, error = run(2, "scene.xml", "--qpos", "x.npy")
    assert "is not an .npy file of numbers: the magic string is not correct" in error
    assert "pickle" not in error
    assert "unsafe" not in error


READS_DENORMALS = pytest.mark.skipif(
    int(mujoco.__version__.split(".")[0]) < 4,
    reason="3.3.5 calls numbers this small too large",
)


@pytest.mark.parametrize(
    ("size", "dtype", "fits"),
    [
        (b"1e39 1 1", "float32", False),
        (b"1e39 1 1", "float64", True),
        (b"1 1 1e-39", "float32", False),
        (b"1 1 1e-39", "float64", True),
        pytest.param(b"1 1 1e-310", "float64", False, marks=READS_DENORMALS),
    ],
)
def test_sizes_beyond_the_dtype_are_refused(folder, run, size, dtype, fits):
    Path("x.xml").write_bytes(scene_bytes(b"\x1b").replace(b".1 .2 .3", size))
    _, error = run(0 if fits else 2, "x.xml", *FEW, "--dtype", dtype)
    if not fits:
        assert error.startswith(r"error: \x1b: size [")
        assert error.endswith(f"] m is beyond {dtype}")


@READS_DENORMALS
def test_a_plate_may_be_as_thin_as_it_likes(folder, run):
    Path("x.xml").write_bytes(scene_bytes().replace(b".5 .4 .02", b".5 .4 1e-320"))
    run(0, "x.xml", *FEW)


# What was found is printed; statuses.


def test_an_arena_too_small_loses_only_the_comparison(folder, run, monkeypatch):
    Path("small.xml").write_bytes(scene_bytes(extra=b'<size memory="2K"/>'))
    if mujoco.__version__ < "3.9":  # It had enough.
        error = mujoco.FatalError("mj_stackAlloc: out of memory\n")
        monkeypatch.setattr(mujoco, "mj_geomDistance", fail(error))
    out, error = run(2, "small.xml", *COMPARED)
    assert error.startswith("error: MuJoCo: mj_stackAlloc: out of memory")
    assert "between the three tests: 0 disagreements on 10 pairs in states" in out
    assert "with MuJoCo C" not in out
    report = json.loads(run(2, "small.xml", *COMPARED, "--json")[0])
    assert report["states"] == 5
    assert report["mujoco"] is report["agree"] is None


def fail(error):
    def failing(*args, **kwargs):
        raise error

    return failing


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (RuntimeError("a\n\x1bb"), 3, r"unexpected error: RuntimeError: a \x1bb"),
        (AssertionError(), 3, "unexpected error: AssertionError: (test_cli_faults.py:"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_the_unexpected_has_a_status_and_a_line(
    folder, run, monkeypatch, error, status, line
):
    monkeypatch.setattr(job, "crosscheck", fail(error))
    out, said = run(status, "scene.xml", *FEW)
    assert said.startswith(line)
    assert "deepest overlap by margin" in out
    report = json.loads(run(status, "scene.xml", *FEW, "--json")[0])
    assert report["states"] == 5
    assert report["agree"] is None
    monkeypatch.setattr(job, "load", fail(error))
    assert run(status, "scene.xml", *FEW)[0] == ""


@pytest.mark.parametrize(
    ("error", "status", "printed"),
    [(RuntimeError("x"), 3, True), (KeyboardInterrupt(), 130, False)],
)
def test_batches_before_an_error_count(
    folder, run, monkeypatch, error, status, printed
):
    """But for Ctrl-C: it may have come in the middle of a sum."""
    rows = job.random_states

    def failing(model, count, seed):
        states = rows(model, count, seed)
        return states._replace(
            rows=lambda i, j: states.rows(i, j) if i < 4 else fail(error)()
        )

    monkeypatch.setattr(job, "random_states", failing)
    out, _ = run(status, "scene.xml", *FEW, "--batch", "2")
    assert ("4 of 5 states (random, seed 0)" in out) == printed
    out, _ = run(status, "scene.xml", *FEW, "--batch", "2", "--json")
    assert (out and json.loads(out)["states"]) == (4 if printed else "")


def test_a_disagreement_found_before_an_error_is_no_open_question(
    folder, run, monkeypatch
):
    monkeypatch.setattr(job, "crosscheck", fail(RuntimeError()))
    monkeypatch.setattr("jaxbe.cli.sweep.ratio_rounding", lambda *_: np.zeros(2))
    compiled = jaxbe.cli.sweep.compile_tests

    def wrong(*args):
        tests = compiled(*args)
        tests.timed["minkowski"] = lambda b, e: ~tests.timed["all_features"](b, e)
        return tests

    monkeypatch.setattr("jaxbe.cli.sweep.compile_tests", wrong)
    assert json.loads(run(3, "scene.xml", *FEW, "--json")[0])["agree"] is False


def test_every_status_is_documented():
    from jaxbe.cli import arguments

    readme = (Path(__file__).parents[1] / "README.md").read_text()
    said = re.search(r"Exit status:[^.]*\.", readme)[0]
    for name, value in vars(jaxbe.cli).items():
        if name.startswith("EXIT_"):
            assert f"\n  {value}  " in arguments.EPILOG
            assert f" {value} " in " ".join(said.split())


# Memory.


def test_a_batch_that_no_machine_holds_is_refused(folder, run):
    huge = str(2_000_000_000_000)
    _, error = run(2, "scene.xml", "--states", huge, "--batch", huge)
    assert "2,000,000,000,000 states at a time take some " in error
    assert error.endswith("GB of memory: give a smaller --batch")


def test_a_batch_larger_than_the_states_is_legal(folder, run):
    run(0, "scene.xml", *FEW, "--batch", "2000000000")


@pytest.mark.parametrize("known", [True, False])
def test_memory_that_ends_is_no_riddle(folder, run, monkeypatch, known):
    if not known:
        monkeypatch.delattr(os, "sysconf")
    for error in (
        MemoryError(),
        jaxbe.cli.memory.jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of"),
    ):
        monkeypatch.setattr("jaxbe.cli.sweep.compile_tests", fail(error))
        _, said = run(2, "scene.xml", *FEW)
        assert said.endswith("more than there is of memory: give a smaller --batch")
    error = jaxbe.cli.memory.jax.errors.JaxRuntimeError("INTERNAL: other")
    monkeypatch.setattr("jaxbe.cli.sweep.compile_tests", fail(error))
    assert "INTERNAL: other" in run(3, "scene.xml", *FEW)[1]


def test_the_memory_of_a_batch_is_about_that(folder):
    """The README's 100 MB for 250,000 pairs."""
    assert BYTES_PER_PAIR * 250_000 == 100e6


@pytest.mark.parametrize("option", ["--states", "--batch", "--sample", "--rows"])
def test_numbers_of_ten_thousand_digits(run, option):
    _, error = run(2, option, "9" * 10_000)
    assert f"argument {option}: must have at most 100 digits" in error


# Streams.


class Broken(io.TextIOBase):
    """A stream that nobody reads, or whose disk is full."""

    encoding = "utf-8"

    def __init__(self, error):
        self._error = error

    def write(self, text):
        raise self._error

    def fileno(self):
        raise OSError


BROKEN = [BrokenPipeError(32, "Broken pipe"), OSError(28, "No space left on device")]


@pytest.mark.parametrize("error", BROKEN)
@pytest.mark.parametrize("option", [[], ["--json"]])
def test_standard_output_that_cannot_be_written(
    folder, monkeypatch, capsys, error, option
):
    monkeypatch.setattr(sys, "stdout", Broken(error))
    assert main(["scene.xml", *FEW, *option]) == 3
    said = f"jaxbe: error: cannot write to standard output: {error.strerror}\n"
    assert capsys.readouterr().err == said
    assert main(["--help"]) == 3
    assert capsys.readouterr().err == said


def test_no_standard_output_at_all(folder, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", None)
    assert main(["scene.xml", *FEW]) == 3
    assert "it is closed" in capsys.readouterr().err


@pytest.mark.parametrize("stream", [None, Broken(BROKEN[0])])
def test_standard_error_that_cannot_be_written(folder, monkeypatch, capsys, stream):
    monkeypatch.setattr(sys, "stderr", stream)
    assert main(["scene.xml", *FEW]) == 0
    assert "deepest overlap" in capsys.readouterr().out
    assert main(["missing.xml"]) == 2
    assert capsys.readouterr().out == "", "print(file=None) would write here"


@pytest.mark.parametrize("option", [[], ["--json"], ["--help"]])
def test_standard_output_in_ascii(folder, option):
    Path("odd.xml").write_bytes(scene_bytes("Löffel→".encode()))
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        assert main(["odd.xml", *FEW, *option]) == 0
    written = out.buffer.getvalue().decode("ascii")
    if option != ["--help"]:
        escaped = r"L\u00f6ffel\u2192" if option else r"L\xf6ffel\u2192"
        assert escaped in written


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="not on this system")
@pytest.mark.parametrize("target", ["/dev/full", "a closed pipe"])
def test_a_process_whose_output_nobody_gets(target):
    """Nor does Python add a line of its own when it exits."""
    if target == "/dev/full":
        out = os.open(target, os.O_WRONLY)
    else:
        read, out = os.pipe()
        os.close(read)
    command = [sys.executable, "-m", "jaxbe", "--help"]
    done = subprocess.run(command, stdout=out, stderr=subprocess.PIPE, text=True)
    os.close(out)
    assert done.returncode == 3
    assert done.stderr.startswith("jaxbe: error: cannot write to standard output: ")
    assert done.stderr.count("\n") == 1


def test_warnings_of_mujoco_go_to_standard_error_and_not_into_a_file(
    folder, capsys, monkeypatch
):
    compare = job.crosscheck

    def warning(model, data, pairs, drawn):
        unstable = mujoco.MjData(model)
        unstable.qvel[:] = np.nan
        mujoco.mj_step(model, unstable)
        return compare(model, data, pairs, drawn)

    monkeypatch.setattr(job, "crosscheck", warning)
    before = mujoco.get_mju_user_warning()
    assert main(["scene.xml", *FEW, "--json"]) == 0
    out, err = capsys.readouterr()
    assert err.startswith("jaxbe: warning: MuJoCo: Nan, Inf or huge value in QVEL")
    assert json.loads(out)["agree"] is True
    assert os.listdir() == ["scene.xml"]
    assert mujoco.get_mju_user_warning() is before


# The picture.


@pytest.fixture
def drawn(monkeypatch):
    """Writes quickly what stands for a picture."""

    def render(view, path, backend):
        assert path.parent == Path(os.path.realpath("out.png")).parent
        path.write_bytes(b"a picture")

    monkeypatch.setattr(picture, "_render", render)


def test_a_picture_is_written_beside_and_renamed(folder, run, drawn):
    run(0, "scene.xml", *FEW, "--picture", "out.png")
    assert sorted(os.listdir()) == ["out.png", "scene.xml"]
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(Path("out.png").stat().st_mode) == 0o666 & ~umask
    Path("out.png").write_bytes(b"older")
    Path("out.png").chmod(0o640)
    text, _ = run(0, "scene.xml", *FEW, "--picture", "out.png")
    assert text.splitlines()[-1].endswith(": out.png")
    assert Path("out.png").read_bytes() == b"a picture"
    assert stat.S_IMODE(Path("out.png").stat().st_mode) == 0o640


@pytest.mark.parametrize("error", [RuntimeError("x"), KeyboardInterrupt(), BROKEN[1]])
def test_a_picture_that_fails_leaves_the_old_one_and_nothing_else(
    folder, run, monkeypatch, error
):
    Path("out.png").write_bytes(b"older")
    monkeypatch.setattr(picture, "draw", fail(error))
    status = {RuntimeError: 3, KeyboardInterrupt: 130, OSError: 2}[type(error)]
    out, said = run(status, "scene.xml", *FEW, "--picture", "out.png")
    assert "with MuJoCo C: 0 disagreements" in out
    assert Path("out.png").read_bytes() == b"older"
    assert sorted(os.listdir()) == ["out.png", "scene.xml"]
    if status == 2:
        assert said == "error: cannot write out.png: No space left on device"


def test_a_picture_goes_through_links(folder, run, monkeypatch):
    def render(view, path, backend):
        assert path.parent.name == "far"
        path.write_bytes(b"a picture")

    monkeypatch.setattr(picture, "_render", render)
    Path("far").mkdir()
    Path("link.png").symlink_to("far/away.png")
    for _ in ("dangling", "and not"):
        run(0, "scene.xml", *FEW, "--picture", "link.png")
        assert Path("link.png").is_symlink()
        assert os.listdir("far") == ["away.png"]
        assert Path("far/away.png").read_bytes() == b"a picture"
        Path("far/away.png").write_bytes(b"older")


@pytest.mark.parametrize("name", ["robot.xml", "x.svg", "picture", "x.npy", ".png", ""])
def test_what_is_no_name_of_a_picture_is_refused(folder, run, drawn, name):
    before = sorted(os.listdir())
    _, error = run(2, "scene.xml", *FEW, "--picture", name)
    assert error.startswith(f"error: cannot write {name or '.'}: ")
    assert sorted(os.listdir()) == before


def test_a_forgotten_name_does_not_replace_the_model(folder, run):
    _, error = run(2, *FEW, "--picture", "scene.xml")
    assert error == "error: cannot write scene.xml: a picture's name ends in .png"
    assert Path("scene.xml").read_bytes() == scene_bytes()


@pytest.mark.parametrize("how", ["same", "symlink", "hard link"])
@pytest.mark.parametrize("source", ["scene.xml", "states.npy"])
def test_an_input_is_not_replaced(folder, run, drawn, how, source):
    """Whatever its name is."""
    np.save("states.npy", np.zeros((2, 1)))
    inputs = {"scene.xml": "scene.xml", "states.npy": "states.npy"}
    if how == "same":
        Path(source).rename("in.png")
        inputs[source] = "in.png"
    elif how == "symlink":
        Path(source).rename("target.png")
        Path(source).symlink_to("target.png")
        Path("in.png").symlink_to("target.png")
    else:
        os.link(source, "in.png")
    before = Path("in.png").read_bytes()
    arguments = [inputs["scene.xml"], "--qpos", inputs["states.npy"]]
    _, error = run(2, *arguments, "--picture", "in.png")
    assert error == "error: cannot write in.png: it is an input"
    assert Path("in.png").read_bytes() == before


def test_a_texture_is_not_replaced(folder, run, drawn):
    from jaxbe.viz.offscreen import png

    Path("textures").mkdir()
    Path("textures/wood.png").write_bytes(png(np.zeros((4, 4, 3), np.uint8)))
    Path("scene.xml").write_bytes(
        scene_bytes(
            extra=b'<compiler texturedir="textures"/>'
            b'<asset><texture name="t" type="2d" file="wood.png"/></asset>'
        )
    )
    _, error = run(2, "scene.xml", *FEW, "--picture", "textures/wood.png")
    assert "the scene is made of a file of this name" in error


def test_only_regular_files_are_replaced(folder, run, drawn):
    os.mkfifo("pipe.png")
    Path("device.png").symlink_to(os.devnull)
    Path("folder.png").mkdir()
    Path("loop.png").symlink_to("loop.png")
    for name, words in {
        "pipe.png": "not a regular file",
        "device.png": "not a regular file",
        "folder.png": "Is a directory",
        "loop.png": "Too many levels of symbolic links",
        "missing/x.png": "No such file or directory",
        "x" * 300 + ".png": "File name too long",
    }.items():
        _, error = run(2, "scene.xml", *FEW, "--picture", name)
        assert error == f"error: cannot write {name}: {words}"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may")
def test_what_is_protected_is_not_replaced(folder, run, drawn):
    Path("out.png").write_bytes(b"kept")
    Path("out.png").chmod(0o444)
    assert "Permission denied" in run(2, "scene.xml", *FEW, "--picture", "out.png")[1]


@pytest.mark.parametrize("search", [None, f"{os.pathsep}elsewhere"])
def test_a_module_beside_the_scene_is_not_executed(folder, monkeypatch, search):
    """Python's -m and an empty entry of PYTHONPATH look into the current folder."""
    poison = "open('poisoned', 'w').close()"
    for name in ("mujoco", "numpy", "json", "jax", "jaxbe", "zlib", "sitecustomize"):
        Path(f"{name}.py").write_text(poison)
    if search is None:
        monkeypatch.delenv("PYTHONPATH", raising=False)
    else:
        monkeypatch.setenv("PYTHONPATH", search)
    view = View("missing.xml", [0.0], [], [1, 0], [])
    reason = picture._render(view, Path("out.png"), "disable")
    assert "missing.xml" in reason, "so it ran"
    assert not Path("poisoned").exists()


def test_nor_by_the_command_as_a_module(folder):
    for name in ("mujoco", "rich", "matplotlib"):
        Path(f"{name}.py").write_text("open('poisoned', 'w').close()")
    done = subprocess.run(
        [sys.executable, "-m", "jaxbe", "missing.xml"],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2, done.stderr
    assert not Path("poisoned").exists()


def test_what_the_renderer_says_is_escaped(folder, run, monkeypatch):
    """It may be anything: a library's message in another encoding."""
    monkeypatch.setattr(sys, "executable", str(folder / "python"))
    Path("python").write_text('#!/bin/sh\nprintf "\\033[31m\\377" >&2; exit 1')
    Path("python").chmod(0o755)
    monkeypatch.setattr(picture, "_backends", lambda: ["egl"])
    out, _ = run(0, "scene.xml", *FEW, "--picture", "out.png")
    assert r"drawn by matplotlib (MuJoCo could not render: egl: \x1b[31m\xff)" in out


# Words.


def test_the_smallest_distance_and_the_smallest_margin_do_not_contradict(
    folder, run, monkeypatch
):
    """Of two pairs one is deeper by its size, the other in metres."""
    compiled = jaxbe.cli.sweep.compile_tests

    def two_scales(*args):
        tests = compiled(*args)
        contact = tests.timed["contact"]
        scale = np.array([1.0, 10.0])

        def scaled(box, ellipsoid):
            found = contact(box, ellipsoid)
            return found._replace(distance=found.distance * scale)

        tests.timed["contact"] = scaled
        return tests

    monkeypatch.setattr("jaxbe.cli.sweep.compile_tests", two_scales)
    np.save("states.npy", np.full((1, 1), 0.27))
    out, _ = run(0, "scene.xml", "--qpos", "states.npy", "--sample", "0")
    assert "deepest overlap by margin: state 0, hand and shelf, distance -970 mm" in out
    assert "deepest overlap by distance: tool/geom2 and shelf, distance -" in out
    np.save("states.npy", np.full((1, 1), 0.2))
    out, _ = run(0, "scene.xml", "--qpos", "states.npy", "--sample", "0")
    assert "by margin: state 0, tool/geom2 and shelf" in out
    assert "by distance" not in out, "the same pair"
