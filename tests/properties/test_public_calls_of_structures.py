"""Every public call that one beam has, of a structure: the beam cut in two and welded again gives
the same, or the call is refused in a sentence.

A public name without a row fails the last test.
"""

import inspect
import io
from dataclasses import dataclass, field, replace
from functools import cache
from tempfile import TemporaryDirectory

import matplotlib
import matplotlib.pyplot as plt
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam import sensors as S

matplotlib.use("Agg")
SECTION = dict(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
GIVEN = {"F": torch.tensor([0.1, 0.2, 0.3])}
PUSHED = {"F": torch.tensor([-1.0, 0.0, 0.0])}
UP = {"F": torch.tensor([0.1, 0.0, 0.3])}
T = torch.tensor([0.0, 0.01, 0.02])
UPWARDS = torch.tensor([0.0, 0.0, 1.0])
ROWS = [0, 1, 3]  # nodes of the halves that are those of the beam


@dataclass(frozen=True)
class Whole:
    """One clamped beam, with a force at its tip."""

    EI: object = 1.0
    effects: tuple = (tb.Gravity((0, 0, -9.81)), tb.Damping(0.01))
    section: dict = field(default_factory=dict)
    plane: object = None

    on: object = None  # the name of what has the tip

    def own(self):
        return tb.Section.from_stiffness(**SECTION | {"EI": self.EI} | self.section)

    def node(self, k):
        return k

    @property
    def scene(self):
        force = tb.PointLoad(self.node(2), force=tb.Input("F", 3))
        return tb.Scene(self.beams(), [force, *self.effects], plane=self.plane, **self.held())

    def beams(self):
        return tb.Beam.straight(1.0, 2, self.own())

    def held(self):
        return {}

    def nodes(self, state):
        return state.nodes

    def with_(self, **other):
        return replace(self, **other)

    @property
    def named(self):
        return {} if self.on is None else {"on": self.on}

    def rest(self):
        return self.with_(effects=()).scene

    def equilibrium(self, **options):
        return tb.equilibrium(self.scene, inputs=GIVEN, tolerance=1e-11, engine="eager", **options)

    def run(self, **options):
        options = {"engine": "eager", "step": 0.01, "inputs": GIVEN, "tolerance": 1e-12} | options
        return tb.simulate(self.scene, T, **options)


@dataclass(frozen=True)
class Halves(Whole):
    """The same, cut in two and welded again."""

    on: object = "b"

    def node(self, k):
        return ("a", k) if k < 1 else ("b", k - 1)

    def beams(self):
        return {
            "a": tb.Beam.straight(0.5, 1, self.own()),
            "b": tb.Beam.straight(0.5, 1, self.own(), root=(0.5, 0, 0)),
        }

    def held(self):
        return dict(joints=[tb.Weld(("a", -1), ("b", 0))], supports=[tb.Support(("a", 0))])

    def nodes(self, state):
        return state.nodes[..., ROWS, :]


def linear(of):
    return model_of(type(of))


@cache
def model_of(kind):
    of = kind()
    outputs = [S.TipPosition(**of.named), S.NodeVelocity(of.node(1))]
    return tb.linearize(of.scene, of.equilibrium(), outputs, inputs=GIVEN)


def jacobian(of):
    """What does not depend on which coordinates tell a state: trace, and inputs to outputs."""
    model = linear(of)
    A, B = tb.Stepper(of.scene, 0.01, engine="eager", tolerance=1e-13).jacobian(
        model.state, GIVEN, model
    )
    return torch.cat((A.diagonal().sum()[None], (model.C @ A @ B).flatten()))


def state_at(of):
    """The tip after a small motion that two steps have made, from its own coordinates."""
    model, after = linear(of), of.run().state[-1]
    return of.nodes(model.state_at(model.departure(after)))


def gradient(of, run):
    EI = torch.tensor(1.0, requires_grad=True)
    value = run(of.with_(EI=EI))
    return torch.autograd.grad(value.sum(), EI)[0]


def pathway(of, engine):
    """Where the tip has come by 1 cm: points between depend on how many nodes there are."""
    goal = dict(control=lambda state: of.nodes(state)[..., -1, 2], target=[-0.01])
    return of.nodes(tb.path(of.scene, **goal, inputs=GIVEN, tolerance=1e-11, engine=engine).state)


def bent(of):
    nodes = of.scene.beam.nodes
    frames = torch.eye(3).expand(len(nodes), 3, 3)
    bent = nodes + 0.1 * nodes[:, :1] ** 2 * UPWARDS
    return of.nodes(tb.State.from_nodes(of.scene, bent, frames))


def advised(of):
    tip = S.TipPosition(**of.named)
    options = dict(inputs=GIVEN, step=0.01, repeats=1, show=False)
    return torch.tensor(len(f"{tb.advise(of.scene, T, tip, **options)}") > 0)


def batch(of):
    EI = torch.tensor([1.0, 1.5])
    return of.nodes(of.with_(EI=EI).run().state)


def vmapped(of):
    def tip(EI):
        return of.nodes(of.with_(EI=EI).equilibrium())[-1]

    return torch.func.vmap(tip)(torch.tensor([1.0, 1.5]))


def forward(of):
    def tip(EI):
        return of.nodes(of.with_(EI=EI).equilibrium())[-1]

    return torch.func.jvp(tip, (torch.tensor(1.0),), (torch.tensor(1.0),))[1]


def saved(of):
    state, memory = of.run().state[-1], io.BytesIO()
    torch.save(state, memory)
    memory.seek(0)
    again = torch.load(memory, weights_only=True)
    return of.nodes(tb.Stepper(of.scene, 0.01, engine="eager")(again, inputs=GIVEN))


def stepped(of, engine="eager", **options):
    stepper = tb.Stepper(of.scene, 0.01, engine=engine, tolerance=1e-12, **options)
    state = stepper.begin(stepper.rest(), inputs=GIVEN)
    for _ in range(2):
        state = stepper(state, inputs=GIVEN)
    assert stepper.engine == {"eager": "eager", "compiled": "native"}[engine]
    return state


def rolled(of):
    stepper = tb.Stepper(of.scene, 0.01, engine="eager", tolerance=1e-12)
    return tb.rollout(stepper, stepper.rest(), 2, GIVEN)


def sensitivities(of):
    stepper = tb.Stepper(of.scene, 0.01, engine="eager", tolerance=1e-13)
    F = GIVEN["F"].clone().requires_grad_()
    return tb.rollout_jacobian(stepper, stepper.rest(), 2, {"F": F}, tip_of(of), F)[1]


def tip_of(of):
    return lambda states: of.nodes(states)[..., -1, :]


def identified(of):
    def tip(p):
        return of.nodes(of.with_(EI=p["EI"]).equilibrium())[..., -1, :]

    data = tip({"EI": torch.tensor(1.3)})
    return tb.identify(tip, data, {"EI": 1.0}, sigma=1e-3, derivatives="adjoint").theta


def sampled(of):
    laws = {"EI": tb.laws.Uniform(0.9, 1.1)}
    made = tb.monte_carlo(lambda EI: of.nodes(of.with_(EI=EI).equilibrium())[..., -1, :], laws, 4)
    return made.mean.value if hasattr(made.mean, "value") else made.mean


def animated(of):
    with TemporaryDirectory() as folder:
        return torch.tensor(tb.plot.animate(of.run(), f"{folder}/a.gif", dpi=20).exists())


def mode_filmed(of):
    modes = tb.modes(of.scene, count=1, inputs=GIVEN)
    with TemporaryDirectory() as folder:
        path = tb.plot.mode_film(modes, f"{folder}/a.gif", scene=of.scene, fps=2, dpi=20)
        return torch.tensor(path.exists())


def filed(of):
    """The tip after a step from a state that was read from a file."""
    with TemporaryDirectory() as folder:
        tb.save(of.run().state[-1], f"{folder}/a.pt", scene=of.scene)
        again = tb.load(f"{folder}/a.pt", scene=of.scene)
    return of.nodes(tb.Stepper(of.scene, 0.01, engine="eager")(again, inputs=GIVEN))


def viewed(of):
    pytest.importorskip("viser")
    view = tb.view(of.run(), scene=of.scene)
    with TemporaryDirectory() as folder:
        page = view.save(f"{folder}/a.html").exists()
    view.close()
    return torch.tensor(page)


def exported(of):
    with TemporaryDirectory() as folder:
        return torch.tensor(tb.export(of.run(), f"{folder}/a.pvd").exists())


def drawn(of, plot):
    ax = plot()
    found = torch.tensor([len(ax.lines) + len(ax.collections) > 0])
    plt.close("all")
    return found


def read(make):
    """A sensor's readings at an equilibrium and in a motion."""

    def value(of):
        sensor = make(of)
        return torch.cat([sensor(state).flatten() for state in states_of(type(of))])

    return value


@cache
def states_of(kind):
    """At rest, and in motion."""
    return kind().equilibrium(), kind().run().state[-1]


FLOOR = tb.Plane((0.0, 0, -0.02), (0, 0, 1.0))
CONTACT = (tb.Contact(FLOOR, thickness=0.05, force=1.0, friction=0.1, slip_speed=0.1),)


def touching(sensor):
    """Of a contact on the outer half, which of one beam is read along it all."""

    def value(of):
        of = of.with_(effects=CONTACT)
        return sensor(of.scene, 0)(of.run().state[-1]).sum()[None]

    return value


def tendon(of):
    eyelets = [(of.node(k), (0, 0, 0.05)) for k in (0, 1, 2)]
    of = of.with_(effects=(tb.Tendon(eyelets, tension=1.0),))
    state = of.run().state[-1]
    return torch.cat((S.TendonTension(0)(state), S.TendonLength(0)(state)))


def part_of(of):
    return {} if of.on is None else {"on": "a"}


# what is asked -> by the beam and by its halves, who give the same to 1e-9 of its size
# fmt: off
SAME = {
    "rest": lambda of: of.nodes(tb.rest(of.scene)),
    "simulate": lambda of: of.nodes(of.run().state),
    "simulate: native": lambda of: of.nodes(of.run(engine="compiled").state),
    "simulate: midpoint4": lambda of: of.nodes(of.run(method="midpoint4").state),
    "simulate: generalized_alpha": lambda of: of.nodes(of.run(method="generalized_alpha",
        rho_inf=0.8).state),
    "simulate: conserve": lambda of: of.nodes(of.with_(effects=()).run(conserve=True).state),
    "simulate: lumped": lambda of: of.nodes(of.run(lumped=True).state),
    "simulate: checkpoint": lambda of: gradient(of,
        lambda of: of.nodes(of.run(checkpoint=True).state)[-1]),
    "simulate: rtol, atol, first_step, max_steps": lambda of: of.nodes(of.run(step=None,
        tolerance=None, rtol=1e-3, atol=1e-3, first_step=5e-3, max_steps=50).state)[-1],
    "simulate: events": lambda of: (of.run(step=None, tolerance=None, rtol=1e-3,
        events=lambda state: of.nodes(state)[..., -1, 2] - 1e-4).event.t),
    "simulate: halvings, iterations, throw, progress": lambda of: of.nodes(of.run(halvings=2,
        iterations=9, throw=True, progress=lambda *x: None).state),
    "simulate: initial": lambda of: of.nodes(of.run(initial=of.equilibrium()).state),
    "simulate: inputs": lambda of: of.nodes(of.run(inputs={"F": lambda t: t * GIVEN["F"]}).state),
    "Solution: energies": lambda of: torch.stack(of.run().energy),
    "Solution: a batch": batch,
    "Stepper": lambda of: of.nodes(stepped(of)),
    "Stepper: native": lambda of: of.nodes(stepped(of, "compiled")),
    "Stepper.jacobian": jacobian,
    "Linear.state_at": state_at,
    "Linear": lambda of: linear(of).response(2.0).abs(),
    "Linear.discrete": lambda of: linear(of).discrete(0.01).response(2.0).abs(),
    "Linear.reduced": lambda of: linear(of).reduced(2, static=True).response(0.5).abs(),
    "linearize": lambda of: torch.linalg.eigvals(linear(of).A).abs().sort()[0][:6],
    "rollout": lambda of: of.nodes(rolled(of)),
    "rollout_jacobian": sensitivities,
    "State": saved,
    "State.from_nodes": bent,
    "advise": advised,
    "equilibrium": lambda of: of.nodes(of.equilibrium()),
    "equilibrium: native": lambda of: of.nodes(tb.equilibrium(of.scene, inputs=GIVEN,
        tolerance=1e-11, engine="compiled")),
    "equilibrium: relax": lambda of: of.nodes(of.equilibrium(relax=True)),
    "equilibrium: branch, throw, initial, t": lambda of: of.nodes(of.equilibrium(branch="stable",
        throw=False, initial=of.equilibrium(), t=1.0)),
    "equilibrium: its gradient": lambda of: gradient(of, lambda of: of.nodes(of.equilibrium())[-1]),
    "equilibrium: torch.func.vmap": vmapped,
    "equilibrium: torch.func.jvp": forward,
    "equilibrium: in a plane": lambda of: of.nodes(tb.equilibrium(of.with_(plane="xz").scene,
        inputs=UP, tolerance=1e-11, engine="eager")),
    "path": lambda of: pathway(of, "eager"),
    "path: native": lambda of: pathway(of, "compiled"),
    "critical_load": lambda of: (tb.critical_load(of.with_(effects=(), plane="xy", EI=1.0).scene,
        4.0, points=3, inputs=PUSHED, engine="eager").factor),
    "modes": lambda of: tb.modes(of.scene, count=3, inputs=GIVEN).eigenvalue.abs(),
    "modes: lumped": lambda of: tb.modes(of.scene, count=2, lumped=True, inputs=GIVEN).frequency,
    "pair_modes": lambda of: (tb.pair_modes(tb.modes(of.scene, count=3, inputs=GIVEN), torch.eye(2),
        lambda s: s[..., -1, 1:3]).frequency),
    "observe": lambda of: tb.observe(of.run(), S.TipPosition(**of.named), [0.005, 0.015]),
    "identify": identified,
    "monte_carlo": sampled,
    "S.Angles": read(lambda of: S.Angles(of.node(2), kind="tait-bryan")),
    "S.Component": read(lambda of: S.Component(S.TipPosition(**of.named), 2)),
    "S.ContactForce": touching(S.ContactForce),
    "S.ContactForces": touching(S.ContactForces),
    "S.ContactGap": touching(lambda *x: lambda s: S.ContactGap(*x)(s).amin()),
    "S.ContactPoints": touching(lambda *x: lambda s: S.ContactPoints(*x)(s)[:, 3:6].sum(0)),
    "S.ContactPressure": touching(lambda *x: lambda s: S.ContactPressure(*x)(s).amax()),
    "S.ContactSlip": touching(lambda *x: lambda s: S.ContactSlip(*x)(s).amax()),
    "S.Curvature": read(lambda of: S.Curvature(element=0, beam=of.scene, **part_of(of))),
    "S.Gauge": read(lambda of: S.Gauge(element=0, beam=of.scene, y=0.1, **part_of(of))),
    "S.Position": read(lambda of: S.Position(0.1, of.scene, point=(0, 0, 0.1), **part_of(of))),
    "S.Strain": read(lambda of: S.Strain(element=0, beam=of.scene, **part_of(of))),
    "S.Stress": read(lambda of: S.Stress(element=0, beam=of.scene, **part_of(of))),
    "S.SectionForces": read(lambda of: lambda s: S.SectionForces(of.scene, GIVEN)(s)[0, 0]),
    "S.NodePosition": read(lambda of: S.NodePosition(of.node(2))),
    "S.NodeRotation": read(lambda of: S.NodeRotation(of.node(2))),
    "S.NodeVelocity": read(lambda of: S.NodeVelocity(of.node(2))),
    "S.Reaction": read(lambda of: S.Reaction(0)),
    "S.RootForce": read(lambda of: S.RootForce(**part_of(of))),
    "S.RootMoment": read(lambda of: S.RootMoment(**part_of(of))),
    "S.RootReaction": read(lambda of: S.RootReaction(**part_of(of))),
    "S.Spin": read(lambda of: S.Spin(of.node(2))),
    "S.Stack": read(lambda of: S.Stack([S.TipPosition(**of.named), S.TipVelocity(**of.named)])),
    "S.TipPosition": read(lambda of: S.TipPosition(**of.named)),
    "S.TipVelocity": read(lambda of: S.TipVelocity(**of.named)),
    "S.TendonTension": tendon,
    "S.TendonLength": tendon,
    "export": exported,
    "save, load: a state": filed,
    "view": viewed,
    "plot.animate": animated,
    "plot.shape": lambda of: drawn(of, lambda: tb.plot.shape(of.equilibrium())),
    "plot.energies": lambda of: drawn(of, lambda: tb.plot.energies(of.run())),
    "plot.diagram": lambda of: drawn(of, lambda: tb.plot.diagram(of.equilibrium(), "M2",
        scene=of.scene, inputs=GIVEN)),
    "plot.symbols": lambda of: drawn(of, lambda: tb.plot.symbols(of.equilibrium(), scene=of.scene,
        inputs=GIVEN)),
    "plot.reactions": lambda of: drawn(of, lambda: tb.plot.reactions(of.equilibrium(),
        scene=of.scene)),
    "plot.mode_film": mode_filmed,
    "plot.history": lambda of: drawn(of, lambda: tb.plot.history(of.run(),
        S.TipPosition(**of.named))),
    "plot.mode_shapes": lambda of: drawn(of, lambda: tb.plot.mode_shapes(of.equilibrium(),
        tb.modes(of.scene, count=1, inputs=GIVEN))),
    "plot.orbits": lambda of: drawn(of, lambda: tb.plot.orbits(of.equilibrium(),
        tb.modes(of.scene, count=1, inputs=GIVEN).shape[..., 0, :, :])),
    "describe": lambda of: torch.tensor(len(f"{tb.describe(of.scene)}") > 0)[None],
}
# fmt: on


# what is asked of the halves -> words of the sentence that refuses it
REFUSED = {
    "simulate: form": lambda of: of.run(form="minimal", step=None, tolerance=None, engine="auto"),
    "simulate: explicit": lambda of: tb.simulate(of.scene, T, method="rk4", inputs=GIVEN),
    "simulate: accuracy": lambda of: tb.simulate(of.scene, T, accuracy=0.1, inputs=GIVEN),
    "equilibrium: accuracy": lambda of: tb.equilibrium(of.scene, accuracy=0.1, inputs=GIVEN),
    "modes: accuracy": lambda of: tb.modes(of.scene, accuracy=0.1, inputs=GIVEN),
    "ExplicitStepper": lambda of: tb.ExplicitStepper(of.scene, 1e-3),
    "block_rate": lambda of: tb.block_rate(of.scene, None, inputs=GIVEN),
    "consistent_state": lambda of: tb.consistent_state(of.scene, inputs=GIVEN),
    "remesh": lambda of: tb.remesh(of.scene, 8),
    "S.NodeAcceleration": lambda of: S.NodeAcceleration(of.node(2), of.scene, GIVEN),
    "S.RootSpringLoad": lambda of: of.with_(effects=(tb.RootSpring((1e3, 20.0)),)).scene,
}


# a second and more each, and proved in other words elsewhere
LONG = {
    "advise", "critical_load", "equilibrium: native", "identify", "path: native",
    "simulate: checkpoint", "simulate: events", "simulate: rtol, atol, first_step, max_steps",
}  # fmt: skip


@pytest.mark.parametrize(
    "call", [pytest.param(x, marks=pytest.mark.long) if x in LONG else x for x in SAME]
)
def test_halves_are_the_beam(call):
    one, two = (SAME[call](of) for of in (Whole(), Halves()))
    size = max(1e-6, one.detach().abs().max().item()) if one.dtype.is_floating_point else 0
    assert_close(two, one, rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("call", REFUSED)
def test_what_a_structure_has_not(call):
    with pytest.raises(ValueError) as refusal:
        REFUSED[call](Halves())
    assert "\n" not in str(refusal.value)


# public names that see no scene, or make parts of one
OTHERS = """Accelerogram Actuation Advice Along Ball Beam BlockRate Body BoucWen Box Campbell
Capsule Comparison Contact Convergence Critical CrossSection Cylinder Cylindrical Damping
Description Design Distance Drag Drive DynamicStall ElastoPlastic Energy Estimate FieldFit Fit
Frame Gravity Gust Hinge History Induction Input LineLoad Load MassDamping Material Measurement
MixedState Modes MomentDerivatives PairedModes Parameter Path PerElement PerInterval Plane
PointLoad PointMass Polar Pose RareEvent RootMotion RootSpring Samples Scene Section SelfContact
SensorFrame Slider SlowBaseline SlowPathWarning SmoothHistory SmoothRotation Smoothness
SobolIndices Sphere Spring Stations Stats Stream StripAir Support Table Tendon TipLoad Tornado
Turbulence Universal View Viscoelastic Weld Wind WindTable laws modal_assurance plot
pose_from_points rayleigh sensors"""
# of functions of the user's own, as identify and monte_carlo; of other scenes, made by remesh
FUNCTIONS = "identify_fields moment_derivatives monte_carlo_stream rare_event sobol_indices tornado"
FUNCTIONS += " blade_element_momentum campbell compare converge design Filtered KalmanFilter"
FUNCTIONS += " MovingHorizon read unbalance_response"
# of answers, whatever gave them; of joints, which one beam has not; a base
READ = "plot.axes plot.bands plot.campbell plot.convergence plot.correlation plot.cross_section"
READ += (
    " plot.design plot.fit plot.grid plot.histogram plot.load_path plot.obstacles"
    " plot.profile plot.save plot.tendons"
)
READ += " plot.tornado plot.tried S.JointCoordinate S.JointHysteresis S.JointLoad S.JointRate"
READ += " S.Sensor"


def test_every_public_call_is_in_the_table():
    public = {*tb.__all__, *(f"S.{name}" for name in S.__all__)}
    public |= {f"plot.{name}" for name in tb.plot.__all__}
    rows = {name for row in (*SAME, *REFUSED) for name in row.split(":")[0].split(", ")}
    left = {*f"{OTHERS} {FUNCTIONS} {READ}".split()}
    assert not rows & left
    assert public - rows - left == set()


@pytest.mark.parametrize("call", [tb.simulate, tb.equilibrium, tb.path, tb.linearize, tb.modes])
def test_every_option_is_in_a_row(call):
    """By its name in the words of a row, or in what the rows share."""
    words = " ".join(row for row in (*SAME, *REFUSED) if row.startswith(call.__name__))
    shared = "scene t method step engine inputs tolerance outputs state count normalize control"
    shared += " target highest lowest load steps form branch initial lumped rho_inf"
    explicit = {"options", "adjoint", "begin", "project", "solver"}  # of explicit methods and forms
    missing = {*inspect.signature(call).parameters} - {*shared.split()} - explicit
    assert {name for name in missing if name not in words} == set()
