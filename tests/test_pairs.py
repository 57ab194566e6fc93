"""Which pairs may collide: against MJX's enumeration and MuJoCo C's contacts."""

import pathlib
import tracemalloc

import mujoco
import numpy as np
import pytest
from mujoco import mjx
from mujoco.mjx._src import collision_driver

from jaxbe.mjx import Pairs, find_pairs
from jaxbe.mjx.pairs import BOX, ELLIPSOID

pytestmark = pytest.mark.filterwarnings("ignore:find_pairs")

GEOM_TYPES = ("box", "ellipsoid", "box", "ellipsoid", "sphere", "capsule")


def model_of(xml):
    return mujoco.MjModel.from_xml_string(xml)


def two_bodies(inner="", ellipsoid="", box="", option="", contact=""):
    """An ellipsoid's body with a box's body beside it, or `inner` in it."""
    return model_of(f"""
    <mujoco><option>{option}</option><worldbody>
      <body name="a"><freejoint/>
        <geom name="e" type="ellipsoid" size="1 2 3" {ellipsoid}/>{inner}
      </body>
      <body name="b"><freejoint/><geom name="b" type="box" size="1 1 1" {box}/></body>
    </worldbody><contact>{contact}</contact></mujoco>""")


def random_model(rng, n_bodies=12):
    """Bodies in a tree, some welded, with random bits, excludes and pairs."""
    names = ["world"]
    children = {"world": []}
    n_geoms = 0
    content = {}
    for i in range(n_bodies):
        name = f"body{i}"
        children[names[rng.integers(len(names))]].append(name)
        children[name] = []
        names.append(name)
    for name in names:
        content[name] = "".join(
            _random_geom(rng, f"geom{n_geoms + i}") for i in range(rng.integers(0, 4))
        )
        n_geoms += content[name].count("<geom")

    def body(name):
        joint = "<joint/>" if rng.random() < 0.6 else ""
        inner = content[name] + "".join(map(body, children[name]))
        inertia = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        return f'<body name="{name}">{inertia}{joint}{inner}</body>'

    def two_of(n):
        return rng.choice(n, size=2, replace=False)

    bodies = {tuple(sorted(two_of(len(names)))) for _ in range(rng.integers(0, 6))}
    excludes = [f'<exclude body1="{names[j]}" body2="{names[i]}"/>' for i, j in bodies]
    couples = [two_of(n_geoms) for _ in range(rng.integers(0, 6)) if n_geoms > 1]
    pairs = [f'<pair geom1="geom{i}" geom2="geom{j}"/>' for i, j in couples]
    flag = rng.choice(["enable", "disable"])
    return model_of(f"""
    <mujoco><option><flag filterparent="{flag}"/></option>
      <worldbody>{content["world"]}{"".join(map(body, children["world"]))}</worldbody>
      <contact>{"".join(excludes)}{"".join(pairs)}</contact>
    </mujoco>""")


def _random_geom(rng, name):
    contype, conaffinity = rng.integers(0, 4, size=2)
    return (
        f'<geom name="{name}" type="{rng.choice(GEOM_TYPES)}" size=".3 .2 .1" '
        f'pos="{" ".join(map(str, rng.uniform(-0.5, 0.5, 3)))}" '
        f'contype="{contype}" conaffinity="{conaffinity}"/>'
    )


def by_mjx(model):
    """The ellipsoid-box pairs that MJX itself enumerates, sorted."""
    pairs = {(int(g1), int(g2)) for g1, g2, _ in collision_driver.geom_pairs(model)}
    types = model.geom_type
    return sorted(p for p in pairs if tuple(types[list(p)]) == (ELLIPSOID, BOX))


def as_list(pairs):
    return [tuple(p) for p in pairs.geom.tolist()]


def test_constants_are_those_of_mujoco():
    assert mujoco.mjtGeom.mjGEOM_ELLIPSOID == ELLIPSOID
    assert mujoco.mjtGeom.mjGEOM_BOX == BOX


def test_pairs_are_those_of_mjx_on_random_models():
    rng = np.random.default_rng(0)
    found = []
    for _ in range(300):
        model = random_model(rng)
        found.append(len(find_pairs(model)))
        assert as_list(find_pairs(model)) == by_mjx(model)
    assert np.count_nonzero(found) > 200, "most models must have pairs"


def test_every_contact_of_mujoco_c_is_among_the_pairs():
    rng = np.random.default_rng(1)
    n_contacts = 0
    for _ in range(100):
        model = random_model(rng)
        data = mujoco.MjData(model)
        data.qpos[:] = rng.uniform(-3, 3, model.nq)
        mujoco.mj_forward(model, data)
        touching = np.sort(data.contact.geom, axis=1)
        order = np.argsort(model.geom_type[touching], axis=1)
        touching = np.take_along_axis(touching, order, axis=1)
        types = model.geom_type[touching]
        touching = touching[(types == (ELLIPSOID, BOX)).all(axis=1)]
        n_contacts += len(touching)
        assert {tuple(t) for t in touching.tolist()} <= set(as_list(find_pairs(model)))
    assert n_contacts > 100


def test_a_pair_is_ellipsoid_then_box_whatever_the_order_of_the_model():
    model = model_of("""
    <mujoco><worldbody>
      <body><freejoint/><geom name="b" type="box" size="1 1 1"/></body>
      <body><freejoint/><geom name="e" type="ellipsoid" size="1 1 1"/></body>
    </worldbody></mujoco>""")
    assert as_list(find_pairs(model)) == [(1, 0)]


@pytest.mark.parametrize(
    ("ellipsoid", "box", "expected"),
    [
        ('contype="1" conaffinity="0"', 'contype="0" conaffinity="1"', 1),
        ('contype="0" conaffinity="1"', 'contype="1" conaffinity="0"', 1),
        ('contype="1" conaffinity="0"', 'contype="1" conaffinity="0"', 0),
        ('contype="2" conaffinity="2"', 'contype="1" conaffinity="1"', 0),
        ('contype="0" conaffinity="0"', "", 0),
    ],
)
def test_contype_meets_conaffinity(ellipsoid, box, expected):
    assert len(find_pairs(two_bodies(ellipsoid=ellipsoid, box=box))) == expected


def test_excluded_bodies_do_not_collide_in_either_order():
    assert len(find_pairs(two_bodies())) == 1
    for names in ('body1="a" body2="b"', 'body1="b" body2="a"'):
        model = two_bodies(contact=f"<exclude {names}/>")
        assert len(find_pairs(model)) == 0


def test_an_explicit_pair_overrules_every_filter_and_is_not_doubled():
    pair = '<pair geom1="b" geom2="e"/>'
    exclude = '<exclude body1="a" body2="b"/>'
    no_bits = 'contype="0" conaffinity="0"'
    assert as_list(find_pairs(two_bodies(contact=pair))) == [(0, 1)]
    excluded = two_bodies(ellipsoid=no_bits, contact=pair + exclude)
    assert as_list(find_pairs(excluded)) == [(0, 1)]


CHILD = '<body><joint/><geom type="box" size="1 1 1"/></body>'
WELDED = '<body><geom type="box" size="1 1 1"/></body>'
GRANDCHILD = f"<body>{CHILD}</body>"
NO_FILTER = '<flag filterparent="disable"/>'


@pytest.mark.parametrize(
    ("inner", "option", "expected"),
    [
        (CHILD, "", 1),
        (CHILD, NO_FILTER, 2),
        (GRANDCHILD, "", 1),  # the body between is welded to the ellipsoid's
        (WELDED, "", 1),
        (WELDED, NO_FILTER, 1),
    ],
)
def test_parents_and_welded_bodies(inner, option, expected):
    model = two_bodies(inner=inner, option=option)
    assert len(find_pairs(model)) == expected
    assert as_list(find_pairs(model)) == by_mjx(model)


def test_children_of_the_world_collide_with_it():
    model = model_of("""
    <mujoco><worldbody><geom type="box" size="1 1 1"/>
      <body><joint/><geom type="ellipsoid" size="1 1 1"/></body>
    </worldbody></mujoco>""")
    assert as_list(find_pairs(model)) == [(1, 0)]


@pytest.mark.parametrize("flag", ["contact", "constraint"])
def test_the_flags_of_the_simulation_do_not_matter(flag):
    model = two_bodies(option=f'<flag {flag}="disable"/>')
    assert len(find_pairs(model)) == 1


@pytest.mark.parametrize("flag", ["contact", "constraint"])
def test_a_model_that_disables_contacts_has_no_pairs_if_asked(flag):
    model = two_bodies(option=f'<flag {flag}="disable"/>')
    pairs = find_pairs(model, only_enabled=True)
    assert pairs.geom.shape == (0, 2)
    assert pairs.explicit.shape == (0, 2)
    on_device = mjx.put_model(with_spheres_for_ellipsoids(model))
    assert on_device.opt.disableflags == model.opt.disableflags
    assert len(find_pairs(on_device, only_enabled=True)) == 0


def with_spheres_for_ellipsoids(model):
    """What MJX loads."""
    model.geom_type[model.geom_type == ELLIPSOID] = mujoco.mjtGeom.mjGEOM_SPHERE
    return model


@pytest.mark.parametrize("option", ["", '<flag gravity="disable" limit="disable"/>'])
def test_other_flags_leave_the_pairs(option):
    assert len(find_pairs(two_bodies(option=option), only_enabled=True)) == 1


def test_contacts_and_flags_agree_with_mujoco_c():
    """There are pairs where MuJoCo makes contacts, and none where it makes none."""
    for flag in ("contact", "constraint", "gravity"):
        model = two_bodies(option=f'<flag {flag}="disable"/>')
        data = mujoco.MjData(model)
        data.qpos[7:10] = 0.5, 0.3, 0.2  # MuJoCo 3.3.5 finds none at one centre
        mujoco.mj_forward(model, data)
        assert len(find_pairs(model, only_enabled=True)) == min(data.ncon, 1)


def test_explicit_pairs_are_listed_with_their_elements():
    """Twice in the model, among elements of other kinds; restricted with them."""
    model = model_of("""
    <mujoco><worldbody>
      <body><freejoint/><geom name="e" type="ellipsoid" size="1 1 1"/></body>
      <body><freejoint/><geom name="b" type="box" size="1 1 1"/></body>
      <body><freejoint/><geom name="c" type="box" size="1 1 1"/></body>
      <body><freejoint/><geom name="s" type="sphere" size="1"/></body>
    </worldbody><contact><pair geom1="s" geom2="e"/><pair geom1="c" geom2="e"/>
      <pair geom1="e" geom2="c"/></contact></mujoco>""")
    pairs = find_pairs(model)
    assert as_list(pairs) == [(0, 1), (0, 2)]
    for row, element in pairs.explicit:
        named = {int(model.pair_geom1[element]), int(model.pair_geom2[element])}
        assert named == set(pairs.geom[row].tolist())
    rows, elements = pairs.explicit.T
    assert rows.tolist() == [1, 1]
    assert len(set(elements.tolist())) == 2
    of_one = find_pairs(model, ["c"]).explicit
    assert of_one[:, 0].tolist() == [0, 0]
    assert of_one[:, 1].tolist() == elements.tolist()
    assert find_pairs(model, ["b"]).explicit.shape == (0, 2)
    with pytest.raises(ValueError, match="read-only"):
        pairs.explicit[0, 0] = 7


@pytest.fixture
def three_boxes():
    bodies = "".join(
        f'<body><freejoint/><geom name="b{i}" type="box" size="1 1 1"/></body>'
        for i in range(3)
    )
    return model_of(f"""
    <mujoco><worldbody>{bodies}
      <body><freejoint/><geom name="e" type="ellipsoid" size="1 1 1"/></body>
      <body><freejoint/><geom type="sphere" size="1"/></body>
    </worldbody></mujoco>""")


@pytest.mark.parametrize(
    ("geoms", "expected"),
    [
        (None, [(3, 0), (3, 1), (3, 2)]),
        (["e"], [(3, 0), (3, 1), (3, 2)]),
        (["b1"], [(3, 1)]),
        (["b2", "b0", "b2"], [(3, 0), (3, 2)]),
        ([1, "b2"], [(3, 1), (3, 2)]),
        ([np.int32(1)], [(3, 1)]),
        ([4], []),
        ([], []),
    ],
)
def test_geoms_restrict_to_pairs_with_one_of_them(three_boxes, geoms, expected):
    assert as_list(find_pairs(three_boxes, geoms)) == expected


@pytest.mark.parametrize(
    ("geoms", "message"),
    [
        (["nobody"], "no geom named 'nobody'"),
        ([""], "no geom named ''"),
        ([5], "ids must be from 0 to 4, got 5"),
        ([-1], "ids must be from 0 to 4, got -1"),
    ],
)
def test_unknown_geoms_are_named(three_boxes, geoms, message):
    with pytest.raises(ValueError, match=message):
        find_pairs(three_boxes, geoms)


@pytest.mark.parametrize("geoms", ["b1", b"b1", 1, None.__class__])
def test_one_geom_is_not_a_list_of_them(three_boxes, geoms):
    with pytest.raises(TypeError, match="geoms must be a list of names or ids, got"):
        find_pairs(three_boxes, geoms)


@pytest.mark.parametrize(
    "geom", [1.9, 0.0, np.float64(1), True, np.True_, b"b1", None, [1], 1j]
)
def test_what_is_neither_a_name_nor_an_id_is_refused(three_boxes, geom):
    with pytest.raises(TypeError, match="geoms must be names or integer ids, got"):
        find_pairs(three_boxes, [geom])


NOT_MODELS = {
    "path": ("robot.xml", "got 'robot.xml': load it with .*from_xml_path"),
    "Path": (pathlib.Path("robot.xml"), "load it with .*from_xml_path"),
    "spec": (mujoco.MjSpec(), "got MjSpec: compile it"),
    "data": (mujoco.MjData(two_bodies()), "got MjData, which is data, not a model"),
    "None": (None, "got None"),
    "number": (3, "got int"),
}


@pytest.mark.parametrize("kind", NOT_MODELS)
def test_what_is_not_a_model_is_named(kind):
    given, message = NOT_MODELS[kind]
    with pytest.raises(TypeError, match=f"model must be .*MjModel.*{message}"):
        find_pairs(given)


# Nothing takes part.

FLOOR = '<geom name="floor" type="plane" size="1 1 1"/>'
LINKS = '<body><freejoint/><geom name="l{i}" type="capsule" size="1 1"/></body>'


def arm_of_capsules(n_boxes=3):
    boxes = '<geom type="box" size="1 1 1"/>' * n_boxes
    links = "".join(LINKS.format(i=i) for i in range(4))
    return model_of(f"<mujoco><worldbody>{FLOOR}{boxes}{links}</worldbody></mujoco>")


def assert_warns(message, *arguments, **options):
    """One warning, which names the line of this file that called."""
    with pytest.warns(UserWarning, match=message) as caught:
        pairs = find_pairs(*arguments, **options)
    assert len(pairs) == 0
    assert [w.filename for w in caught] == [__file__]


def test_a_model_in_which_nothing_takes_part_says_so():
    there = "it has 3 boxes, 0 ellipsoids, 1 plane, 4 capsules"
    assert_warns(there, arm_of_capsules())
    assert_warns(there, arm_of_capsules(), only_enabled=True)
    assert_warns("1 box, 0 ellipsoids, 1 plane", arm_of_capsules(n_boxes=1))
    assert_warns("0 boxes, 0 ellipsoids", model_of("<mujoco/>"))
    assert_warns(there, arm_of_capsules(), ["l1", "floor"])


def test_a_model_whose_filters_take_everything_says_so():
    none = two_bodies(ellipsoid='contype="0" conaffinity="0"')
    assert_warns("1 box, 1 ellipsoid.*contype", none)


def test_geoms_that_take_no_part_say_so(three_boxes):
    assert_warns(r"of the 1 chosen .*0 boxes, 0 ellipsoids, 1 sphere", three_boxes, [4])
    assert_warns("of the 0 chosen .*0 boxes, 0 ellipsoids", three_boxes, [])
    assert_warns("of the 2 chosen .*1 box, 0 ellipsoids, 1 plane",
                 arm_of_capsules(), ["floor", 1])  # fmt: skip


def test_there_is_no_warning_where_pairs_are_or_none_were_wanted(recwarn):
    assert len(find_pairs(two_bodies())) == 1
    for flag in ("contact", "constraint"):
        model = two_bodies(option=f'<flag {flag}="disable"/>')
        assert len(find_pairs(model, only_enabled=True)) == 0
    assert not recwarn.list


def test_an_mjx_model_gives_the_same_pairs(three_boxes, monkeypatch):
    key = (mjx.GeomType.ELLIPSOID, mjx.GeomType.BOX)
    with pytest.raises(NotImplementedError):
        mjx.put_model(three_boxes)
    stand_in = collision_driver.ellipsoid_ellipsoid
    monkeypatch.setitem(collision_driver._COLLISION_FUNC, key, stand_in)
    on_device = mjx.put_model(three_boxes)
    for geoms in (None, ["b1"], [2]):
        expected = as_list(find_pairs(three_boxes, geoms))
        assert as_list(find_pairs(on_device, geoms)) == expected


def test_an_mjx_model_with_excludes_gives_the_same_pairs():
    # The filter keeps its pairs from MJX, the explicit pair is of spheres.
    model = model_of("""
    <mujoco><worldbody>
      <body name="a"><freejoint/><geom type="ellipsoid" size="1 1 1"/></body>
      <body name="b"><freejoint/><geom type="box" size="1 1 1"/></body>
      <body><freejoint/><geom name="s" type="sphere" size="1" contype="0"/></body>
      <body><freejoint/><geom name="t" type="sphere" size="1" contype="0"/></body>
    </worldbody><contact><exclude body1="a" body2="b"/><pair geom1="s" geom2="t"/>
    </contact></mujoco>""")
    assert len(find_pairs(mjx.put_model(model))) == 0


def test_a_model_without_such_geoms_has_no_pairs():
    pairs = find_pairs(model_of("<mujoco/>"))
    assert pairs.geom.shape == (0, 2)
    assert len(pairs) == 0


def test_pairs_cannot_be_changed():
    pairs = find_pairs(two_bodies())
    with pytest.raises(ValueError, match="read-only"):
        pairs.geom[0, 0] = 7


def test_pairs_can_be_static_under_jit():
    pairs = Pairs(np.array([[0, 1]]))
    assert isinstance(hash(pairs), int)


@pytest.mark.parametrize(
    ("geom", "error", "message"),
    [
        ([[0, -1]], ValueError, "geom ids must not be negative, got -1"),
        ([[0.0, 1.0]], TypeError, "geom must be of integer ids, got float64"),
        ([[True, False]], TypeError, "geom must be of integer ids, got bool"),
        ([0, 1], ValueError, r"geom must have shape \(P, 2\), got \(2,\)"),
        ([[0, 1, 2]], ValueError, r"geom must have shape \(P, 2\), got \(1, 3\)"),
    ],
)
def test_pairs_made_by_hand_are_checked(geom, error, message):
    with pytest.raises(error, match=f"Pairs: {message}"):
        Pairs(np.array(geom))
    with pytest.raises(error, match=f"Pairs: {message.replace('geom', 'explicit', 1)}"):
        Pairs(np.array([[0, 1]]), np.array(geom))


def test_pairs_made_by_hand_are_their_own():
    """Neither do they follow the array they were made of, nor lock it."""
    given = np.array([[0, 1]])
    pairs = Pairs(given)
    given[0, 0] = 7
    assert as_list(pairs) == [(0, 1)]
    assert as_list(Pairs([[2, 3]])) == [(2, 3)]


def lattice(n, n_free=1):
    """n ellipsoids on some bodies that move, and n boxes of the world."""
    boxes = '<geom type="box" size="1 1 1"/>' * n
    ellipsoids = '<geom type="ellipsoid" size="1 1 1"/>' * (n // n_free)
    body = f'<body><joint type="slide"/>{ellipsoids}</body>'
    return model_of(f"<mujoco><worldbody>{boxes}{body * n_free}</worldbody></mujoco>")


def test_a_model_of_many_pairs():
    bodies = "".join(
        f'<body><freejoint/><geom type="{kind}" size="1 1 1"/></body>'
        for kind in ("ellipsoid", "box")
        for _ in range(500)
    )
    model = model_of(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    assert len(find_pairs(model)) == 250_000


def test_many_pairs_are_found_quickly_and_in_little_memory():
    """Of 3,000 by 3,000 geoms; their ids alone take 144 MB. It was 6.6 s and 1.1 GB."""
    model = lattice(3000, n_free=1000)
    pairs = find_pairs(model)
    assert len(pairs) == 9_000_000
    del pairs
    tracemalloc.start()
    pairs = find_pairs(lattice(1000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * pairs.geom.nbytes


def test_many_pairs_are_those_of_mjx_whatever_the_portions(monkeypatch):
    """Cut into portions of a few ellipsoids each, the last of them short."""
    monkeypatch.setattr("jaxbe.mjx.pairs.AT_ONCE", 30)
    rng = np.random.default_rng(2)
    for _ in range(30):
        model = random_model(rng)
        assert as_list(find_pairs(model)) == by_mjx(model)
    test_explicit_pairs_are_listed_with_their_elements()
