"""`jax.export` with batch shapes that are symbols: one program for all lengths."""

import functools

import jax
import numpy as np
import pytest
from jax import export

import jaxbe
from benchmarks import scenes


def gradient(function):
    def total(*pair):
        return sum(x.sum() for x in jax.tree.leaves(function(*pair)))

    return jax.grad(total, argnums=(0, 1))


def turned(box, ellipsoid):
    """By a quaternion made of what is at hand."""
    wxyz = box.axes.reshape(*box.axes.shape[:-2], 9)[..., :4]
    box = jaxbe.Box.from_quaternion(box.center, wxyz, box.half_extents)
    return jaxbe.overlap(box, ellipsoid)


contact = functools.partial(jaxbe.contact, steps=1)
FUNCTIONS = {
    **{m: functools.partial(jaxbe.overlap, method=m) for m in jaxbe.METHODS},
    "scaled_distance": jaxbe.scaled_distance,
    "margin": jaxbe.margin,
    "margin_bounds": jaxbe.margin_bounds,
    "signed_distance": jaxbe.signed_distance,
    "distance_bounds": functools.partial(jaxbe.distance_bounds, steps=1),
    "contact": contact,
    "certify": jaxbe.certify,
    "from_quaternion": turned,
    "gradient of scaled_distance": gradient(jaxbe.scaled_distance),
    "gradient of margin": gradient(jaxbe.margin),
    "gradient of contact": gradient(contact),
}


def exported(function, box_shape, ellipsoid_shape):
    """A function of six arrays, whose results are a flat list."""
    scope = export.SymbolicScope()
    forms = [
        jax.ShapeDtypeStruct((*export.symbolic_shape(shape, scope=scope), *tail), "f4")
        for shape in (box_shape, ellipsoid_shape)
        for tail in ((3,), (3, 3), (3,))
    ]

    def flat(*fields):
        pair = jaxbe.Box.unchecked(*fields[:3]), jaxbe.Ellipsoid.unchecked(*fields[3:])
        return jax.tree.leaves(function(*pair))

    return export.export(jax.jit(flat))(*forms)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_all_functions(name):
    program = exported(FUNCTIONS[name], "n", "n")
    assert all(str(x.shape[0]) == "n" for x in program.out_avals)


@pytest.mark.parametrize("shapes", [("a, 1", "1, b"), ("a, 1", "b"), ("a, b", "b")])
def test_symbolic_shapes_broadcast(shapes):
    program = exported(jaxbe.overlap, *shapes)
    assert str(program.out_avals[0].shape) == "(a, b)"


def test_one_program_answers_batches_of_any_length():
    program = exported(jaxbe.scaled_distance, "n", "n")
    for count in (1, 7, 20):
        scene = scenes.random(count).astype(np.float32)
        found = program.call(*scene)[0]
        expected = jaxbe.scaled_distance(*scene.bodies())
        np.testing.assert_allclose(found, expected, rtol=1e-5)
