"""The pictures: not blank, of what they should show, and clear where they cannot."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import jaxbe
from jaxbe import viz
from tests.test_cli import NO_OPENGL, pixels, share_of

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure

RED, BLUE, GREEN, YELLOW = (1, 0.25, 0.1), (0.1, 0.45, 1), (0.2, 0.7, 0.3), (1, 0.9, 0)
APART, DEEP = (0.45, 0.1, 0.3), (0.2, 0.1, 0.1)

SCENE = """
<mujoco>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="box" size="0.3 0.2 0.1"/>
    <body pos="0 0 0.5"><joint type="slide" axis="0 0 1"/>
      <geom type="ellipsoid" size="0.2 0.1 0.1"/></body>
    <body mocap="true" pos="0.6 0.3 0"><geom type="box" size="0.1 0.1 0.1"/></body>
  </worldbody>
</mujoco>
"""


def pair(center, dtype=np.float64):
    box = jaxbe.Box.from_quaternion(*numbers(dtype, (0, 0, 0), (1, 0.1, 0.2, 0)))
    ellipsoid = jaxbe.Ellipsoid.from_quaternion(
        *numbers(dtype, center, (1, 0.4, 0.3, 0), (0.3, 0.12, 0.1))
    )
    return box, ellipsoid


def numbers(dtype, center, wxyz, lengths=(0.3, 0.2, 0.1)):
    return tuple(np.array(x, dtype) for x in (center, wxyz, lengths))


def image_of(axes, path):
    axes.figure.savefig(path, dpi=50)
    return pixels(path)


@pytest.mark.parametrize(("center", "plane"), [(APART, True), (DEEP, False)])
def test_a_pair_is_seen_and_the_plane_only_where_there_is_one(center, plane, tmp_path):
    axes = viz.draw_pair(*pair(center, np.float32))
    image = image_of(axes, tmp_path / "pair.png")
    assert share_of(image, RED) > 0.01
    assert share_of(image, BLUE) > 0.01
    assert share_of(image, YELLOW) > 0.0005
    assert (share_of(image, GREEN) > 0.005) == plane
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert ("shortest way out" in labels) != plane
    distance = float(jax.jit(jaxbe.contact)(*pair(center, np.float32)).distance)
    said = axes.get_legend().get_title().get_text()
    assert said == f"distance {1000 * distance:.3g} mm"


def test_a_pair_is_drawn_on_axes_given():
    axes = Figure().add_subplot(projection="3d")
    assert viz.draw_pair(*pair(APART, np.float32), axes) is axes


def test_batches_and_nan_are_refused():
    box, ellipsoid = pair(APART, np.float32)
    two = jax.tree.map(lambda x: jnp.stack([x, x]), ellipsoid)
    with pytest.raises(ValueError, match=r"one pair, got batches of shapes \(\) and"):
        viz.draw_pair(box, two)
    with pytest.raises(ValueError, match="one ellipsoid, got batches of shapes"):
        viz.draw_slice(box, two)
    with pytest.raises(ValueError, match="across must be 0, 1 or 2, got 3"):
        viz.draw_slice(box, ellipsoid, across=3)
    nowhere = jaxbe.Ellipsoid.unchecked(
        jnp.full(3, jnp.nan, jnp.float32), ellipsoid.axes, ellipsoid.semi_axes
    )
    with pytest.raises(ValueError, match="needs finite numbers"):
        viz.draw_pair(box, nowhere)


def test_bodies_that_are_missing_or_swapped_are_named():
    box, ellipsoid = pair(APART, np.float32)
    with pytest.raises(ValueError, match="needs a box or an ellipsoid at least"):
        viz.draw_bodies()
    none = jaxbe.Box(*(np.zeros((0, *x.shape), x.dtype) for x in box.fields().values()))
    with pytest.raises(ValueError, match="needs a box or an ellipsoid at least"):
        viz.draw_bodies(none)
    for draw in (viz.draw_bodies, viz.draw_pair, viz.draw_slice):
        with pytest.raises(TypeError, match=r"box must be a jaxbe\.Box, got Ellipsoid"):
            draw(ellipsoid, box)
    with pytest.raises(TypeError, match=r"must be a jaxbe\.Ellipsoid, got Box"):
        viz.draw_bodies(box, box)
    with pytest.raises(TypeError, match=r"box must be a jaxbe\.Box, got NoneType"):
        viz.draw_pair(None, ellipsoid)
    model = mujoco.MjModel.from_xml_string(SCENE)
    with pytest.raises(TypeError, match=r"model must be a mujoco\.MjModel, got MjData"):
        viz.render(mujoco.MjData(model), model)


@pytest.mark.parametrize(("across", "dtype"), [(0, np.float32), (2, np.float64)])
def test_the_touching_curve_of_a_slice_is_where_the_margin_is_zero(
    across, dtype, tmp_path
):
    box, ellipsoid = pair(APART, dtype)
    two = jax.tree.map(lambda x: jnp.stack([x, x]), box)
    far = np.zeros((2, 3), dtype)
    far[1, (across + 1) % 3] = 1.5
    boxes = jaxbe.Box(two.center + far, two.axes, two.half_extents)
    filled = viz.draw_slice(boxes, ellipsoid, across=across, resolution=81, arrows=9)
    image = image_of(filled.axes, tmp_path / "slice.png")
    assert image.std() > 0.05
    touching = filled.axes.collections[2].get_paths()[0].vertices
    centers = np.insert(touching, across, ellipsoid.center[across], axis=1)
    moved = jaxbe.Ellipsoid(
        centers.astype(dtype)[:, None], ellipsoid.axes, ellipsoid.semi_axes
    )
    margins = jax.jit(jaxbe.margin)(boxes, moved).min(axis=-1)
    assert len(margins) > 20
    assert abs(margins).max() < 0.03


def rendered(monkeypatch, opengl, **marks):
    if not opengl:
        for name, value in NO_OPENGL.items():
            monkeypatch.setenv(name, value)
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    data.qpos[0], data.mocap_pos[0] = -0.1, (0.6, 0, 0)
    before = model.body_pos.copy()
    image = viz.render(model, data, **marks)
    np.testing.assert_array_equal(model.body_pos, before)
    assert image.dtype == np.uint8
    return image / 255


@pytest.mark.parametrize("opengl", [True, False])
def test_a_scene_with_its_contacts(monkeypatch, opengl):
    points = np.array([[[0, 0, 0.1], [0, 0, 0.3]], [[0.1, 0, 0.1], [0.1, 0, 0.3]]])
    contacts = jaxbe.Contact(
        distance=np.array([0.2, np.nan]),
        position=points.mean(axis=1),
        normal=np.array([[0, 0, -1.0], [0, 0, -1.0]]),
        on_box=points[:, 0],
        on_ellipsoid=points[:, 1],
    )
    image = rendered(monkeypatch, opengl, contacts=contacts, geom=[[1, 0]])
    assert image.shape == (720, 720, 3)
    assert share_of(image, RED) > 0.005
    assert share_of(image, BLUE) > 0.01
    assert share_of(image, YELLOW) > 0.0003


def test_a_scene_without_contacts(monkeypatch):
    image = rendered(monkeypatch, opengl=False)
    assert image.std() > 0.05
    assert share_of(image, YELLOW) < 1e-4


@pytest.mark.parametrize("name", ["draw_pair", "draw_slice", "render"])
def test_without_matplotlib_the_error_says_what_to_install(name, monkeypatch):
    for module in [m for m in sys.modules if m.startswith("jaxbe.viz.")]:
        monkeypatch.delitem(sys.modules, module)
    for module in [m for m in sys.modules if m.split(".")[0] == "matplotlib"]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'jaxbe\[viz\]'"):
        getattr(viz, name)


def test_other_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="no attribute 'draw_sphere'"):
        _ = viz.draw_sphere


def test_importing_jaxbe_imports_no_pictures():
    code = "import jaxbe, sys; print([m for m in sys.modules if 'viz' in m])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )
    assert done.stdout.strip() == "[]"
