"""What the README links exists, and no placeholder was left."""

import json
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe.mjx
from benchmarks import __main__ as suite
from tests import (  # noqa: F401
    readme_claims,
    readme_figures,
    readme_placing,
    readme_speeds,
)

COMMANDS = {
    "contact-speed-512": "contact_speed, an earlier version with wider vectors",
    **{
        f"scene-{name}": "jaxbe SCENE.xml --states 300000 --sample 300000 --seed 7"
        for name in ("fish", "dog-v2", "arm-and-shelf")
    },
}
"""Of results that do not say what made them."""

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_linked_and_named_files_exist():
    links = re.findall(r"\]\(([^)]+)\)", README)
    named = re.findall(r"`((?:benchmarks|examples|jaxbe|tests)/[\w./-]+\.\w+)`", README)
    assert links
    assert named
    files = (name for name in (*links, *named) if not name.startswith("#"))
    assert not [name for name in files if not (ROOT / name).exists()]
    headings = {
        re.sub(r"[^a-z0-9 -]", "", heading.lower()).replace(" ", "-")
        for heading in re.findall(r"^##+ (.*)$", README, re.M)
    }
    assert not [name for name in links if name[0] == "#" and name[1:] not in headings]


def test_no_placeholder_is_left():
    words = re.findall(r"\b[A-Z]{7,}\b", README)
    assert set(words) <= {"CITATION", "CONTRIBUTING", "ELLIPSOID"}, words


@pytest.mark.parametrize("function", readme_figures.SOURCES, ids=lambda f: f.__name__)
def test_figures_are_those_of_the_results(function):
    """`python -m tests.readme_figures` prints what differs, of all sentences."""
    problems = readme_figures.problems(function, readme_figures.readme())
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("function", readme_figures.SOURCES, ids=lambda f: f.__name__)
def test_a_figure_that_drifts_is_found(function):
    text = readme_figures.readme()
    for claim in readme_figures.claims(function):
        (found,) = readme_figures.find(claim, text)
        for figure in range(1, 1 + len(claim.figures)):
            start, end = found.span(figure)
            drifted = f"{text[:start]}7777{text[end:]}"
            assert readme_figures.problem(claim, drifted), claim.text


def test_every_results_file_names_its_command():
    """In itself, or as the suite's parts and the README do."""
    parts = {name.replace("_", "-") for name in suite.PARTS}
    for file in (ROOT / readme_figures.RESULTS).glob("*-cpu.json"):
        name = file.name.removesuffix("-cpu.json")
        found = json.loads(file.read_text())
        assert "command" in found or name in parts or name in COMMANDS, file.name


def blocks():
    """The Python of the README, as it stands."""
    return re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.usefixtures("jax_as_users_have_it")
def test_the_ten_lines_and_the_plan_run_as_printed(capsys):
    (ten,) = (block for block in blocks() if "parcel = " in block)
    names: dict = {}
    exec(ten, names)
    assert names["touching"].shape == (1000,)
    (plan,) = (block for block in blocks() if "jaxbe.plan(" in block)
    exec(plan, names)
    printed = plan.partition("# float32:")[2].partition(";")[0].strip(" #\n")
    assert printed in capsys.readouterr().out
    (sample,) = re.findall(r"`(plan\([^`]*sample=[^`]*\))`", README)
    assert eval(f"jaxbe.{sample}", names).margin


@pytest.mark.slow
@pytest.mark.usefixtures("jax_as_users_have_it")
def test_the_environment_runs_as_printed(tmp_path):
    """On a model of one's own."""
    file = tmp_path / "robot.xml"
    file.write_text(ROBOT)
    (block,) = (block for block in blocks() if "filter_contacts" in block)
    names: dict = {}
    try:
        exec(block.replace("robot.xml", str(file)), names)
        data = names["mjx"].make_data(names["model"])
        batch = jax.tree.map(lambda x: jnp.stack([x] * 3), data)
        _, clearance, overflow = names["step"](batch)
    finally:
        jaxbe.mjx.disable_collision()
    np.testing.assert_allclose(clearance, 0.2, atol=1e-3)
    assert not overflow.any()


ROBOT = """<mujoco><worldbody><geom type="box" size="1 1 .1" pos="0 0 -.1"/>
<body pos="0 0 .3"><freejoint/><geom type="ellipsoid" size=".3 .2 .1"/></body>
</worldbody></mujoco>"""
