"""The same physics said twice agrees: random scenes turned, mirrored, moved, in other units, later,
in other words, in batches, restarted, by other engines.

Long, with a CSV of all comparisons:  python -m tests.properties.test_metamorphic --seed 5 --cases
                                      1000 --engines eager,auto
"""

import argparse
import dataclasses
import inspect
import sys
import time
from pathlib import Path

import pytest
import torch

import torchbeam as tb
from tests.cases.gradient_cases import IMPLICIT, Spec
from tests.cases.gradient_effects import FOILS, WINDS
from tests.cases.gradient_ingredients import TABLE
from tests.cases.metamorphic_answers import ANSWERS
from tests.cases.metamorphic_fuzz import Metamorphic, compare, said
from tests.cases.metamorphic_parts import NotHere
from tests.cases.metamorphic_relations import RELATIONS
from tests.cases.metamorphic_similarity import FIELDS, quantities
from tests.cases.metamorphic_users import EFFECTS as USERS
from torchbeam.extend import METHODS, Tree, own_leaves

EFFECTS = [
    kind
    for name in tb.__all__
    if inspect.isclass(kind := getattr(tb, name)) and hasattr(kind, "kind")
]
CONSTRUCTORS = {  # -> ingredient of random scenes that calls it
    "Section": {
        "": "6x6",
        "rectangle": "rectangle",
        "circle": "circle",
        "from_stiffness": "from_stiffness",
    },
    "Beam": {
        "straight": "straight",
        "arc": "arc",
        "curve": "curve number",
        "from_nodes": "from_nodes tensor",
    },
}
SEEDED = 7


@pytest.mark.parametrize("kind", EFFECTS, ids=lambda kind: kind.__name__)
def test_every_effect_has_its_rows(kind):
    """What its numbers are, how it is split, a user's load that does the same, a random ingredient;
    what none of it is: unit/scene/test_effects.py.
    """
    for table in (FIELDS, USERS):
        assert kind in table, f"{kind.__name__} has no row"
    # random scenes run natively as well, which those with these do not: see test_touching
    assert kind is tb.SelfContact or any(name.startswith(kind.called) for name in TABLE["effect"])


@pytest.mark.parametrize(
    "of",
    [
        tb.Gravity((0, 0, 1.0)),
        tb.TipLoad(force=(0, 0, 1.0)),
        tb.LineLoad(force=(0, 0, 1.0)),
        tb.Damping(0.1),
        tb.MassDamping(0.1),
        tb.Drag(1.0, 1.0),
        tb.StripAir(1.0),
        tb.PointMass(1.0),
        tb.Actuation(curvature=(0, 0, 1.0)),
        tb.Spring(0, 1.0, (0, 0, 0.0)),
        tb.RootSpring((1.0, 1.0)),
        tb.Contact(tb.Plane((0, 0, 0.0), (0, 0, 1.0)), thickness=1.0, force=1.0),
        tb.SelfContact(thickness=1.0, force=1.0, radius=1.0),
        tb.Load(lambda *a: None, node=-1),
        tb.Support(0),
        tb.Frame(velocity=(0, 0, 1.0)),
        tb.RootMotion(displacement=(0, 0, 1.0)),
    ],
    ids=lambda x: type(x).__name__,
)
def test_every_tensor_of_a_scene_has_its_quantity(of):
    given = {one.name for one in dataclasses.fields(of) if one.init}
    assert set(quantities(of)) == {one.name for one in own_leaves(of)} & given


def test_every_constructor_method_and_support_is_drawn():
    """Of sections and beams; methods of `Stepper`; which components supports hold."""
    for name, rows in CONSTRUCTORS.items():
        kind = getattr(tb, name)
        public = {
            n for n, f in vars(kind).items() if isinstance(f, classmethod) and not n.startswith("_")
        }
        public -= {"from_cross_section"}  # a 6x6, as "" draws one; see test_cross_sections.py
        assert public == set(rows) - {""}
        assert set(rows.values()) <= set(TABLE[name.lower()])
    assert {answer.split()[0] for answer in ANSWERS} >= set(METHODS)
    assert all(name.split()[-1] == "checkpoint" or name in ANSWERS for name in IMPLICIT)
    assert {"tip held", "free"} <= {name.removesuffix(" nothing") for name in TABLE["supports"]}
    assert all(issubclass(kind, Tree) for kind in FIELDS)


FREE = (("supports", "free"),)
PLAIN = (("section", "from_stiffness"), ("beam", "straight"))
TIP = ("effect", "TipLoad.force value")


def scene(number: int, space: str, start: str, *names: tuple[str, str]) -> Spec:
    return Spec(SEEDED + number, "midpoint", space, names, start)


# fmt: off
SCENES = {  # what random scenes draw seldom: one of each, by hand
    "loads": scene(0, "3D", "rest", ("section", "of each element"), ("beam", "arc"),
                   ("effect", "TipLoad.force function"),
                   ("effect", "LineLoad.force value"), ("effect", "Gravity.g value")),
    "plane": scene(1, "xz", "velocity", *PLAIN, ("effect", "TipLoad.force Input"),
                   ("effect", "LineLoad.moment value"),
                   ("effect", "Damping.tau")),
    "user": scene(2, "3D", "spin", *PLAIN, ("effect", "Load along"),
                  ("effect", "Drag flow function"), TIP),
    "free": scene(3, "3D", "velocity", *PLAIN, *FREE, ("effect", "Spring damping linear"),
                  ("effect", "PointMass offset inertia"), TIP),
    "linked": scene(4, "3D", "rest", ("section", "rotated"), ("beam", "linked"),
                    ("effect", "Gravity.g value"), TIP),
}
# fmt: on
HERE = tuple(
    r
    for r in RELATIONS
    if r not in ("engines", "again", "threads", "vmap", "dual") and not r.startswith("numbers")
)
OF_ONE = (
    "words: no ",
    "words: beam by curvature",
    "chunks",
    "single precision",
    "default dtype",
)  # scene is enough


@pytest.mark.parametrize(
    "name", [*list(SCENES)[:4], pytest.param("linked", marks=pytest.mark.long)]
)
def test_scenes_said_twice(name):
    """Each relation that says something about a scene; derivatives, and effects of zero, of the
    first.
    """
    fuzz, first = Metamorphic(SEEDED), name == "loads"
    of = said(SCENES[name], "midpoint", gradient=first)
    for relation in HERE if first else [r for r in HERE if not r.startswith(OF_ONE)]:
        row = fuzz._tried(
            lambda r=relation: compare(of, r),
            (SCENES[name], "midpoint", relation, "eager"),
            "eager",
        )
        if row is not None:
            fuzz._take(row, report=False)
    assert not fuzz.failures
    assert len(fuzz.rows) > 10


@pytest.mark.parametrize("form", [*WINDS, *FOILS])
def test_wings_in_winds_said_twice(form):
    """Each wind, by its own numbers and as a user's function of place and time; each polar. Speeds
    are states of lags, which units do not change here; a batch stands for a mapped stall.
    """
    spec = scene(5, "3D", "velocity", *PLAIN, ("effect", f"StripAir {form}"), TIP)
    of, refused = said(spec, "midpoint", gradient=False), set()
    for relation in ("turned", "mirrored", "moved", "later", "units", "batch", "vmap"):
        try:
            row = compare(of, relation)
        except (NotHere, ValueError):
            refused.add(relation)
        else:
            assert row.passed, row
    assert refused == {"gust": {"units"}, "stall": {"units", "vmap"}}.get(form, set())


BUCKLED = (*PLAIN, ("effect", "TipLoad.force, follower Input"))
BENT = (("section", "from_stiffness"), ("beam", "arc"), TIP, ("effect", "Gravity.g value"))
PULLED = (*PLAIN, TIP, ("effect", "Tendon elastic"))
HELD = (*PLAIN, TIP, ("supports", "inner node held xz"))


@pytest.mark.parametrize(
    "answer, relation, names",
    [
        ("critical_load", "turned", BUCKLED),
        ("critical_load", "units", BUCKLED),
        ("modes", "vmap", BUCKLED),
        ("equilibrium", "words: rest shape by actuation", BENT),
        ("equilibrium", "chunks", BENT),
        ("equilibrium", "turned", PULLED),
        ("equilibrium", "words: supports said", HELD),
    ],
)
def test_what_stands_said_twice(answer, relation, names):
    """A cantilever that buckles under its input; its frequencies mapped over samples; an arc under
    its weight, which is a straight beam that takes its strains by itself; eyelets of a tendon in
    the ground and on the beam; two supports."""
    row = compare(said(Spec(3, "equilibrium", "3D", names), answer, gradient=False), relation)
    assert row.passed, row


SHORT = ("numbers: closure", "numbers: default", "numbers: object", "numbers: module")


@pytest.mark.parametrize(
    "holder",
    [
        *SHORT,
        *(
            pytest.param(r, marks=pytest.mark.long)
            for r in RELATIONS
            if r.startswith("numbers") and r not in SHORT
        ),
    ],
)
def test_a_second_scene_of_the_same_code_has_its_own_numbers(holder):
    """Native code made for functions with one number serves those with another, wherever users keep
    it: in a closure, a default, a partial, an object, a list, a module.
    """
    row = compare(said(SCENES["user"], "midpoint", gradient=False), holder, "eager")
    assert row.passed, row


@pytest.mark.long
@pytest.mark.parametrize("seconds", [400])
def test_random_scenes_said_twice(seconds):
    """Every answer (methods, forms, statics, linear models) in turn with the relations that were
    compared least.
    """
    fuzz = Metamorphic(SEEDED)
    fuzz.run(cases=10_000, each=2, seconds=seconds)
    assert not fuzz.failures
    assert fuzz.rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=1000, help="scenes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of CPU, at most")
    parser.add_argument("--engines", default="eager,auto", help="in turn")
    parser.add_argument("--relations", default="", help="those whose names have this in them")
    parser.add_argument(
        "--out", type=Path, default=Path("out/metamorphic.csv"), help="CSV of all comparisons"
    )
    arguments = parser.parse_args()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    relations = tuple(r for r in RELATIONS if arguments.relations in r)
    begin = time.process_time()
    fuzz = Metamorphic(arguments.seed, relations, tuple(arguments.engines.split(",")))
    fuzz.run(arguments.cases, seconds=arguments.seconds, report=True)
    fuzz.save(arguments.out)
    for sentence, often in fuzz.refused.most_common():
        print(f"refused {often}: {sentence}")
    print("never compared:", sorted(r for r in relations if not fuzz.covered[r]) or "nothing")
    value, gradient = (
        max((getattr(r, name) for r in fuzz.rows), default=0.0) for name in ("value", "gradient")
    )
    print(
        f"{len(fuzz.rows)} comparisons, {len(fuzz.failures)} failures; largest distance of values "
        f"{value:.1e}, of gradients {gradient:.1e}; {time.process_time() - begin:.0f} s of one core"
    )
    sys.exit(bool(fuzz.failures))


if __name__ == "__main__":
    main()
