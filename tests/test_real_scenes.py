"""The main job on models of dm-control, and on one built like them.

The slow tests need the wheel, extracted as data:

    pip download --no-deps dm-control==1.0.50
    unzip -d FOLDER dm_control-1.0.50-py3-none-any.whl
    JAXBE_DM_CONTROL=FOLDER pytest -m slow tests/test_real_scenes.py
"""

import json
import os
from pathlib import Path

import mujoco
import pytest

from jaxbe.cli import main
from jaxbe.mjx import find_pairs

FOLDER = os.environ.get("JAXBE_DM_CONTROL")

FISH = "suite/fish.xml"
DOGS = ("locomotion/walkers/assets/dog_v2/dog.xml", "suite/dog.xml")

LIKE_FISH = """
<mujoco>
  <option><flag gravity="disable" constraint="disable"/></option>
  <worldbody>
    <geom type="plane" size=".5 .5 .1"/>
    <geom name="target" type="sphere" pos="0 .4 .1" size=".04"/>
    <body name="torso" pos="0 0 .1">
      <joint type="free" limited="false"/>
      <geom name="torso" type="ellipsoid" size=".01 .08 .04"/>
      <geom name="torso_massive" type="box" size=".002 .06 .03"/>
      <body name="tail1" pos="0 -.09 0">
        <joint axis="0 0 1" pos="0 .01 0" limited="false" range="-60 60"/>
        <joint axis="0 1 0" pos="0 .01 0" limited="false" range="-30 30"/>
        <geom name="tail1" type="ellipsoid" size=".001 .008 .016"/>
        <body name="tail2" pos="0 -.028 0">
          <joint axis="0 0 1" pos="0 .02 0" limited="false" range="-60 60"/>
          <geom name="tail2" type="ellipsoid" size=".001 .018 .035"/>
        </body>
      </body>
      <body name="finright" pos=".01 0 0">
        <joint axis="0 1 0" limited="false" range="-60 60"/>
        <geom name="finright" type="ellipsoid" pos=".015 0 0" size=".02 .015 .001"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def run(capsys, scene, *arguments):
    """The report; fails unless everything agrees."""
    status = main([str(scene), "--json", *arguments])
    report = json.loads(capsys.readouterr().out)
    assert report["between_methods"]["beyond_rounding"] == 0
    assert report["mujoco"]["disagreements"] == []
    assert status == 0
    return report


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_model_built_like_fish(capsys, tmp_path, precision):
    """Constraints disabled, a thin tail: one pair, over a quarter of a turn away."""
    path = tmp_path / "fish.xml"
    path.write_text(LIKE_FISH)
    arguments = ["--states", "2000", "--sample", "2000", "--dtype", precision]
    report = run(capsys, path, *arguments)
    (pair,) = report["pairs"]
    assert (pair["ellipsoid"], pair["box"]) == ("tail2", "torso_massive")
    assert 0.1 < pair["overlapping"] / 2000 < 0.5
    assert report["mujoco"]["checked"] == 2000


@pytest.fixture
def dm_control():
    if FOLDER is None:
        pytest.skip("JAXBE_DM_CONTROL is not set")
    return Path(FOLDER) / "dm_control"


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("seed", ["0", "1"])
def test_fish_agrees_with_mujoco_c_everywhere(capsys, dm_control, precision, seed):
    arguments = ["--states", "50000", "--sample", "50000", "--seed", seed]
    report = run(capsys, dm_control / FISH, *arguments, "--dtype", precision)
    assert len(report["pairs"]) == 1
    assert report["mujoco"]["checked"] == 50_000


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("scene", DOGS)
def test_dogs_agree_with_mujoco_c_everywhere(capsys, dm_control, precision, scene):
    arguments = ["--states", "20000", "--sample", "100000", "--dtype", precision]
    report = run(capsys, dm_control / scene, *arguments)
    assert len(report["pairs"]) == 181
    assert report["mujoco"]["overlapping"] > 20_000


@pytest.mark.slow
@pytest.mark.parametrize("scene", [FISH, *DOGS])
def test_contacts_of_mujoco_c_are_among_the_pairs(dm_control, scene):
    """Also those of the rest pose, where MuJoCo's own contacts are switched on."""
    model = mujoco.MjModel.from_xml_path(str(dm_control / scene))
    model.opt.disableflags = 0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pairs = {tuple(sorted(p)) for p in find_pairs(model).geom.tolist()}
    kinds = model.geom_type[data.contact.geom]
    for geom, kind in zip(data.contact.geom.tolist(), kinds.tolist(), strict=True):
        if sorted(kind) == [4, 6]:
            assert tuple(sorted(geom)) in pairs
