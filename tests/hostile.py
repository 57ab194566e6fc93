"""Strategies of input that was not meant well: names, scenes, states, arguments."""

from __future__ import annotations

import io

import numpy as np
from hypothesis import strategies as st

NAMES = st.binary(max_size=12) | st.sampled_from(
    [b"", b"\x1b]0;owned\x07", b"\x1b[2J", b"\r", b"\t", b"&#10;", b"\xff\xfe", b"-"]
    + [x.encode() for x in ("\u202e", "\u2028", ":smile:", "[red]", "%s{0}", "e\u0301")]
)
"""Bytes; entities of XML mean what they mean."""

NUMBERS = st.sampled_from(
    ["0", "1", ".1", "-1", "1e-320", "1e-30", "1e30", "1e300", "nan", "inf", "x", ""]
)
ORDINARY = st.floats(0.05, 2).map(repr)

JOINTS = st.sampled_from(
    [
        *4 * ["<freejoint/>"],
        "",
        '<joint type="ball" range="0 50"/>',
        '<joint type="slide" range="0 1"/><joint range="-1e9 1e9"/>',
        '<joint type="slide" range="-1e300 1e300"/>',
        '<joint ref="1e300"/>',
    ]
)

EXTRAS = [
    *10 * [""],
    '<size memory="2K"/>',
    '<size nuser_geom="1"/>',
    '<option ccd_tolerance="0"/>',
    '<option ccd_iterations="0"/>',
    '<statistic extent="1e300"/>',
    '<include file="scene.xml"/>',
    '<asset><mesh file="missing.stl"/></asset>',
    "<!DOCTYPE x [<!ENTITY a 'aaaa'>]>",
    '<compiler autolimits="false"/>',
]


@st.composite
def geoms(draw, kind, number):
    """One of this kind; most have a legal size and a name of their own."""
    numbers = draw(st.sampled_from([*7 * [ORDINARY], NUMBERS]))
    size = " ".join(draw(numbers) for _ in range(3))
    return b'<geom name="%s%s" type="%s" size="%s"/>' % (
        draw(NAMES).translate(None, b'"<&\0').replace(b"#10;", b"&#10;"),
        draw(st.sampled_from([*7 * [number], b""])),
        kind,
        size.encode(),
    )


@st.composite
def scenes(draw):
    """The bytes of a model, nearly always of some pairs."""
    parts = [draw(geoms(b"box", b"0"))]
    for i in range(1, draw(st.integers(2, 4))):
        kind = draw(st.sampled_from([*6 * [b"ellipsoid"], b"box", b"sphere"]))
        joint, geom = draw(JOINTS).encode(), draw(geoms(kind, b"%d" % i))
        parts.append(b"<body>%s%s</body>" % (joint, geom))
    extra = draw(st.sampled_from(EXTRAS)).encode()
    return b"<mujoco>%s<worldbody>%s</worldbody></mujoco>" % (extra, b"".join(parts))


ARRAYS = st.builds(
    lambda shape, dtype, value: np.full(shape, value).astype(dtype),
    st.sampled_from([(), (0,), (1,), (7,), (2, 1), (3, 7), (0, 7), (1, 0), (2, 7, 1)]),
    st.sampled_from(["f8", "f4", "f2", "i8", "u1", "?", "c8", "U3", ">f8", "V3"]),
    st.sampled_from([0.0, 1.0, 1e4, -3.0]),
)


@st.composite
def states(draw):
    """The bytes of a file of states, perhaps broken."""
    file = io.BytesIO()
    np.save(file, draw(ARRAYS))
    return draw(damaged(file.getvalue()))


@st.composite
def damaged(draw, content):
    """Some bytes changed, cut off or added; often none."""
    content = bytearray(content)
    for _ in range(draw(st.sampled_from([0, 0, 1, 1, 4]))):
        place = draw(st.integers(0, max(0, len(content) - 1)))
        new = draw(st.binary(max_size=4))
        old = draw(st.sampled_from([0, 1, len(new), len(content)]))
        content[place : place + old] = new
    return bytes(content)


WORDS = st.text(max_size=8) | st.sampled_from([
    "--", "-", "--help", "--version", "--jso", "-1", "1e3", "0", "\xb2", "\u0663",
    "9" * 99, "\x1b[31m", "\udcff", "a\nb", "scene.xml", "missing.xml", "folder",
    "pipe.png",
])  # fmt: skip
"""Arguments that mean little."""


@st.composite
def arguments(draw):
    """Most are legal; what takes long is not among them."""
    given = ["scene.xml", "--states", "3", "--sample", draw(st.sampled_from("02"))]
    options = {
        "--json": st.just([]),
        "--qpos": st.sampled_from([["states.npy"], ["folder"], ["scene.xml"]]),
        "--geoms": st.lists(WORDS, min_size=1, max_size=2),
        "--batch": st.sampled_from([["1"], ["2000000000"], ["9" * 99], ["x"]]),
        "--rows": st.sampled_from([["0"], ["1"], ["9" * 99], ["-1"]]),
        "--seed": st.sampled_from([["0"], ["9" * 99], ["nan"]]),
        "--dtype": st.sampled_from([["float32"], ["float64"], ["float16"]]),
        "--picture": st.sampled_from(PICTURES).map(lambda name: [name]),
    }
    for option in draw(st.lists(st.sampled_from(list(options)), max_size=4)):
        if option == "--qpos":
            given = [word for word in given if word not in ("--states", "3")]
        given += [option, *draw(options[option])]
    return given + draw(st.just([]) | st.lists(WORDS, max_size=2))


PICTURES = [
    "out.png", "OUT.PNG", "old.png", "link.png", "folder.png", "pipe.png", "loop.png",
    "out.svg", "scene.xml", "states.npy", "missing/out.png", "", "/dev/null",
    "\udcff\x1b.png", "a\nb.png", "linked.png",
]  # fmt: skip
