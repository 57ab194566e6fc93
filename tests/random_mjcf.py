"""Random MJCF models: every rule of which geoms collide, and from which distance on."""

import dataclasses

import numpy as np

ROUND = ("ellipsoid",) * 5
FLAT = ("box",) * 5
OTHERS = ("sphere", "capsule", "cylinder")
JOINTS = (
    "",
    '<joint axis="0 0 1"/>',
    '<joint type="slide" axis="1 1 0"/>',
    '<joint type="ball"/>',
)


@dataclasses.dataclass
class Kind:
    """What the models of a test have in common.

    Attributes:
        geoms: the types of their geoms; always the same number, in a random order.
        is_aligned: on a lattice, turned by right angles; None for half of them.
        margin: the model's own, which overrides all others; None for none.
        inside_mjx: nothing collides but ellipsoids with boxes: MJX has no function for
            some others, and takes long to compile the rest.
    """

    geoms: tuple[str, ...] = ROUND + FLAT + OTHERS
    is_aligned: bool | None = None
    margin: float | None = None
    inside_mjx: bool = False


def random_mjcf(rng: np.random.Generator, kind: Kind) -> str:
    """A model in a metre or two."""
    scene = _Scene(rng, kind)
    names = [f"g{i}" for i in range(len(kind.geoms))]
    types = rng.permutation(kind.geoms)
    geoms = [scene.geom(name, str(x)) for name, x in zip(names, types, strict=True)]
    bodies = scene.bodies(geoms)
    return f"""
    <mujoco>
      <default><geom margin="{scene.length(0.5)}"/></default>
      <option ccd_tolerance="1e-10" ccd_iterations="200" {scene.option()}</option>
      <worldbody>{bodies}</worldbody>
      <contact>{scene.excludes()}{scene.pairs(names, types)}</contact>
    </mujoco>"""


class _Scene:
    def __init__(self, rng: np.random.Generator, kind: Kind) -> None:
        self.rng, self.kind = rng, kind
        by_chance = self.chance(0.5)
        self.is_aligned = by_chance if kind.is_aligned is None else kind.is_aligned
        self.n_bodies = int(rng.integers(3, 8))

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def length(self, probability: float) -> float:
        """A margin or a gap, none most of the time."""
        if not self.chance(probability):
            return 0.0
        return round(float(self.rng.choice([0.01, 0.1, 0.3, self.rng.random()])), 3)

    def vector(self, low: float, high: float) -> str:
        x = self.rng.uniform(low, high, 3)
        if self.is_aligned:
            x = np.round(4 * x) / 4 if low < 0 else np.maximum(np.round(10 * x), 1) / 10
        return " ".join(f"{v:.6g}" for v in x)

    def turned(self) -> str:
        if self.is_aligned:
            return " ".join(str(90 * i) for i in self.rng.integers(0, 4, 3))
        return " ".join(f"{v:.6g}" for v in self.rng.uniform(-180, 180, 3))

    def bits(self, name: str) -> str:
        """Which of the others it may touch; inside MJX only boxes with ellipsoids."""
        own, other = (int(x) for x in self.rng.choice([1, 1, 1, 2, 3, 0], 2))
        if self.kind.inside_mjx:
            own, other = (own | 1, 0) if name == "ellipsoid" else (0, other | 1)
        return f'contype="{own}" conaffinity="{other}"'

    def geom(self, name: str, kind: str) -> str:
        size = self.vector(0.05, 0.4)
        if kind == "ellipsoid" and self.chance(0.3):
            size = " ".join(size.split()[:1] * 3)
        margins = f'margin="{self.length(0.5)}" gap="{self.length(0.4)}"'
        return (
            f'<geom name="{name}" type="{kind}" size="{size}" mass="1" '
            f'pos="{self.vector(-0.4, 0.4)}" euler="{self.turned()}" '
            f"{self.bits(kind)} {margins if self.chance(0.8) else ''}/>"
        )

    def bodies(self, geoms: list[str]) -> str:
        """The world's geoms, and a tree of bodies: jointed, welded, free or mocap."""
        content = [""] * (self.n_bodies + 1)
        for geom in geoms:
            content[self.rng.integers(self.n_bodies + 1)] += geom
        parents = [int(self.rng.integers(-1, i)) for i in range(self.n_bodies)]
        for i in reversed(range(self.n_bodies)):
            body = self.body(f"b{i}", content[i], is_top=parents[i] < 0)
            content[parents[i]] += body
        return content[-1]

    def body(self, name: str, inside: str, is_top: bool) -> str:
        joint, mocap = str(self.rng.choice(JOINTS)), ""
        if is_top and self.chance(0.5):
            joint = "<freejoint/>"
        elif is_top and self.chance(0.3):
            joint, mocap = "", 'mocap="true"'
        inertia = '<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>'
        return (
            f'<body name="{name}" {mocap} pos="{self.vector(-0.6, 0.6)}" '
            f'euler="{self.turned()}">{inertia}{joint}{inside}</body>'
        )

    def option(self) -> str:
        flags = 'filterparent="disable" ' if self.chance(0.3) else ""
        if self.kind.margin is None:
            return f"><flag {flags}/>"
        return f'o_margin="{self.kind.margin}"><flag {flags} override="enable"/>'

    def excludes(self) -> str:
        count = int(self.rng.integers(0, 3))
        two = [self.rng.choice(self.n_bodies, 2, replace=False) for _ in range(count)]
        different = {tuple(sorted(x)) for x in two}
        return "".join(f'<exclude body1="b{b}" body2="b{a}"/>' for a, b in different)

    def pairs(self, names: list[str], types: np.ndarray) -> str:
        """Of an ellipsoid and a box in either order, and outside MJX of any two."""
        found = ""
        for _ in range(self.rng.integers(0, 4)):
            first, second = (
                self.rng.choice(np.flatnonzero(types == x))
                for x in ("ellipsoid", "box")
            )
            if not self.kind.inside_mjx and self.chance(0.3):
                first, second = self.rng.choice(len(names), 2, replace=False)
            two = [names[first], names[second]]
            self.rng.shuffle(two)
            margins = "".join(
                f'{name}="{self.length(0.7)}" '
                for name in ("margin", "gap")
                if self.chance(0.7)
            )
            found += f'<pair geom1="{two[0]}" geom2="{two[1]}" {margins}/>'
        return found
