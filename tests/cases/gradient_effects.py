"""Ingredients of the gradient fuzz: every effect with every one of its arguments. Those of one
value are the rows of `cases.rows`; here are the others, which have several, or depend on the plane.
"""

from functools import partial

import torch

import torchbeam as tb
from cases.rows import ROWS
from tests.cases.gradient_ingredients import FORMS, POLAR, ingredient

EACH = ("PerElement", "PerElement function")


def along(d, name, size, form, axial=False):
    """What may stand where a value along the beam is wanted."""
    if form not in ("Along", *EACH):
        return d.value(name, size, form, axial)
    if form == "Along":
        v, rate = d.vector(name, size, axial), d.number(f"{name} rate", 2.0, 5.0)
        return lambda x: tb.Along(
            lambda s, t: (
                v(x)[..., None, :] * (torch.cos(s) * (1 + t * rate(x)[..., None]))[..., None]
            )
        )
    v = d.vector(name, size, axial, d.count)
    if form == "PerElement":
        return lambda x: tb.PerElement(v(x))
    rate = d.number(f"{name} rate", 2.0, 5.0)
    return lambda x: tb.PerElement(lambda t: v(x) * (1 + torch.sin(rate(x) * t))[..., None, None])


def of_row(row, name, d, form=""):
    size, axial = row.gradient
    v = along(d, name, size, form, axial) if form else d.number(name, size, axial)
    return lambda x: row.make(v(x), d.count)


for name, row in ROWS.items():
    if row.gradient:
        many = ("Along",) * ("along" in row.forms) + EACH * ("element" in row.forms)
        vector = isinstance(row.gradient[1], bool)
        forms = (*FORMS, *many) if vector else ("",)
        ingredient("effect", name, forms)(partial(of_row, row, name))


@ingredient("effect", "History")
def history(d):
    t = d.tensor("History t", torch.tensor([-0.3, 0.11, 0.245, 0.375, 2.0]), size=0.05, alone=True)
    f = d.vector("History values", 0.5, False, 5)
    return lambda x: tb.TipLoad(force=tb.History(t(x), f(x)))


@ingredient("effect", "Damping six")
def damping_six(d):
    tau = d.tensor("Damping tau", 0.01 + 0.02 * d.uniform(6))
    return lambda x: tb.Damping(tau(x), six=True)


@ingredient("effect", "rayleigh")
def rayleigh(d):
    w = d.tensor("rayleigh frequency", torch.tensor([4.0, 20.0]))
    z = d.tensor("rayleigh ratio", torch.tensor([0.1, 0.12]))
    return lambda x: tb.rayleigh(w(x), z(x))


def _drag(d):
    return {
        n: d.number(f"Drag {n}", *r)
        for n, r in dict(
            density=(1.0, 2.0), diameter=(0.2, 0.3), normal=(1.0, 1.3), tangential=(0.1, 0.3)
        ).items()
    }


@ingredient("effect", "Drag flow", ("none", "value", "list", "Input", "function", "tuple"))
def drag(d, form):
    read = _drag(d)
    if form == "none":
        return lambda x: tb.Drag(**{n: r(x) for n, r in read.items()})
    if form in ("value", "list", "Input"):
        flow = d.value("Drag flow", 1.0, form)
        return lambda x: tb.Drag(**{n: r(x) for n, r in read.items()}, flow=flow(x))
    v, rate = d.vector("Drag flow", 1.0), d.number("Drag flow rate", 2.0, 5.0)

    def flow(x):
        def function(position, t):
            found = v(x)[..., None, :] * (
                1 + torch.sin(rate(x) * t)[..., None, None] + 0.3 * position.square().sum(-1, True)
            )
            return found if form == "function" else tuple(found.unbind(-1))

        return function

    return lambda x: tb.Drag(**{n: r(x) for n, r in read.items()}, flow=flow(x))


@ingredient("effect", "Drag added_mass", ("", "flow"))
def added_mass(d, form=""):
    read, added = _drag(d), d.number("Drag added_mass", 0.8, 1.2)
    flow = d.value("Drag flow", 1.0, "value") if form else lambda x: None
    return lambda x: tb.Drag(
        **{n: r(x) for n, r in read.items()}, added_mass=added(x), flow=flow(x)
    )


WINDS, FOILS = ("gust", "turbulence", "table", "induction"), ("polar", "stall")


@ingredient("effect", "StripAir", ("lags", "quasi-steady", "each node", *WINDS, *FOILS))
def strip_air(d, form):
    """Lags of the wake with "lags", "gust" and "stall"."""
    numbers = dict(axis=(0.2, 0.5), lift_slope=(4.0, 7.0), density=(0.1, 0.3))
    read = {n: d.number(f"StripAir {n}", *r) for n, r in numbers.items()}
    wind = d.value("StripAir wind", 1.0, "value")
    nodes = 1 if form != "each node" else d.count + 1
    chord = d.tensor("StripAir chord", 0.2 + 0.1 * d.uniform(nodes))
    field = _wind(d, wind, form) if form in WINDS else wind
    polar = _polar(d, form) if form in FOILS else lambda x: None
    lags = "wagner" if form in ("lags", "gust", "stall") else None

    def air(x):
        given = {n: r(x) if n == "density" else r(x)[..., None] for n, r in read.items()}
        return tb.StripAir(chord(x), **given, wind=field(x), polar=polar(x), lags=lags)

    return air


def _wind(d, mean, form):
    """A field: of shear and a gust, of harmonics, from a table, by a rotor."""
    if form == "gust":
        peak, gradient = d.vector("Gust peak", 1.0), d.number("Gust gradient", 0.5, 1.0)
        p = d.number("Wind exponent", 0.1, 0.3)
        return lambda x: (
            tb.Wind(mean(x), exponent=p(x), height=5.0)
            + tb.Gust(peak(x), gradient(x), speed=5.0, start=-0.1)
        )
    if form == "turbulence":
        sigma, length = d.number("Turbulence sigma", 0.2, 0.5), d.number("Turbulence length", 1, 3)
        up = (1.0, 2.0, 3.0)  # along no mean wind
        return lambda x: tb.Turbulence(mean(x), sigma(x), length(x), up=up, harmonics=3)
    if form == "table":
        values = d.tensor("WindTable values", d.uniform(2, 2, 1, 1, 3, low=-1.0))
        return lambda x: tb.Wind(mean(x)) + tb.WindTable((-0.5, 1.0), values(x), x=(-2.0, 2.0))
    slow = d.tensor("Induction axial", d.uniform(3))
    turn = d.tensor("Induction swirl", d.uniform(3))
    return lambda x: tb.Wind(mean(x)) + tb.Induction((0.0, 0.4, 2.0), slow(x), turn(x))


def _polar(d, form):
    angles = torch.linspace(-3.1, 3.1, 25, dtype=torch.float64)
    cl = d.tensor("Polar cl", torch.sin(2 * angles + 0.1) + 0.1 * d.uniform(25))

    def foil(x):
        return tb.Polar(angles, cl(x), 0.02 + angles.sin() ** 2, -0.1 * angles.sin())

    return foil if form == "polar" else lambda x: tb.DynamicStall(foil(x))


def _node(d):
    return d.pick(1, -1, -2)


@ingredient("effect", "PointMass mass")
def point_mass(d):
    m, node = d.number("PointMass mass", 0.1, 0.3), _node(d)
    return lambda x: tb.PointMass(m(x), node=node)


@ingredient("effect", "PointMass inertia", ("three", "matrix"))
def point_inertia(d, form):
    m, node = d.number("PointMass mass", 0.1, 0.3), _node(d)
    A = d.tensor("PointMass inertia", 0.1 + 0.1 * d.uniform(3, 3))

    def inertia(x):
        a = A(x) if d.plane is None else torch.diag_embed(A(x)[..., 0])
        B = a @ a.mT
        J = B.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None] * torch.eye(3) - B
        return J if form == "matrix" else J.diagonal(dim1=-2, dim2=-1)

    return lambda x: tb.PointMass(m(x), inertia(x), node=node)


@ingredient("effect", "PointMass offset", ("mass", "inertia", "6x6"))
def point_offset(d, form):
    m, e, node = d.number("PointMass mass", 0.1, 0.3), d.vector("PointMass offset", 0.1), _node(d)
    j = d.number("PointMass inertia", 0.01, 0.02) if form != "mass" else None

    def body(x):
        if j is None:
            return tb.PointMass(m(x), offset=e(x), node=node)
        J = j(x)[..., None, None] * torch.eye(3)
        if form == "inertia":
            return tb.PointMass(m(x), J, e(x), node=node)
        zero = torch.zeros_like(m(x))
        a, b, c = e(x).unbind(-1)
        tilde = torch.stack((zero, -c, b, c, zero, -a, -b, a, zero), -1).unflatten(-1, (3, 3))
        mass = m(x)[..., None, None]
        rows = (
            torch.cat((mass * torch.eye(3), -mass * tilde), -1),
            torch.cat((mass * tilde, J - mass * tilde @ tilde), -1),
        )
        return tb.PointMass(torch.cat(rows, -2), node=node)

    return body


@ingredient("effect", "Actuation both")
def actuation_both(d):
    k = d.value("Actuation curvature", 0.4, "function", axial=True)
    e, elements = d.value("Actuation strain", 0.05, "tuple"), d.pick(None, (0,), (-1,))
    return lambda x: tb.Actuation(curvature=k(x), strain=e(x), elements=elements)


@ingredient("effect", "Spring length", FORMS)
def spring_length(d, form):
    k, to, node = d.number("Spring stiffness", 0.5, 1.5), d.value("Spring to", 0.8, form), _node(d)
    length = d.number("Spring length", 0.2, 0.4)
    return lambda x: tb.Spring(node, k(x), to(x), length=length(x))


@ingredient("effect", "Spring damping", ("linear", "length"))
def spring_damping(d, form):
    k, to = d.number("Spring stiffness", 0.5, 1.5), d.value("Spring to", 0.8, "value")
    node = _node(d)
    c = d.number("Spring damping", 0.3, 0.6)
    length = d.number("Spring length", 0.2, 0.4) if form == "length" else None
    return lambda x: tb.Spring(
        node, k(x), to(x), damping=c(x), **({} if length is None else {"length": length(x)})
    )


@ingredient("effect", "RootSpring stiffness", ("six", "pair"))
def root_spring(d, form):
    k = d.tensor("RootSpring stiffness", 3 + 5 * d.uniform(6))
    return lambda x: tb.RootSpring(_six(k(x), form))


def _six(k, form):
    return k if form == "six" else (k[..., :3], k[..., 3:])


@ingredient("effect", "RootSpring damping", ("six", "pair"))
def root_damping(d, form):
    k = d.tensor("RootSpring stiffness", 3 + 5 * d.uniform(6))
    c = d.tensor("RootSpring damping", 0.1 + 0.2 * d.uniform(6))
    return lambda x: tb.RootSpring(_six(k(x), form), _six(c(x), form))


@ingredient("effect", "Contact", ("plane", "sphere", "tapered"))
def contact(d, form):
    """Soft, with what the beam starts in; without friction, as some ways are at rest."""
    place = d.tensor("Contact place", torch.tensor([0.5, 0.0, 0.0]) + 0.02 * d.uniform(3))
    thickness = d.number("Contact thickness", 0.3, 0.4)
    force = d.number("Contact force", 0.3, 0.5)
    radius = d.number("Contact radius", 0.05, 0.1)
    inside = torch.ones(3) if d.plane is None else torch.zeros(3)
    inside[list(POLAR.get(d.plane, ()))] = 1.0
    down = inside * torch.tensor([0.1, -0.5, 0.6])
    if form != "sphere":
        obstacle = lambda x: tb.Plane(inside * place(x) - 0.3 * down, down)  # noqa: E731
    else:
        obstacle = lambda x: tb.Sphere(inside * place(x) - 0.5 * down, radius(x) + 0.3)  # noqa: E731
    own = radius
    if form == "tapered":
        s = d.tensor("Contact places", torch.tensor([0.1, 0.4, 0.9]) + 0.1 * d.uniform(3))
        taper = d.tensor("Contact taper", torch.tensor([1.0, 1.3, 0.7]) + 0.1 * d.uniform(3))
        own = lambda x: tb.Table(s(x), radius(x)[..., None] * taper(x))  # noqa: E731
    return lambda x: tb.Contact(obstacle(x), thickness=thickness(x), force=force(x), radius=own(x))


@ingredient("effect", "Tendon", ("tension", "elastic"))
def tendon(d, form):
    """From the ground to the tip over the root; without friction, as not all ways take it."""
    inside = torch.ones(3) if d.plane is None else torch.zeros(3)
    inside[list(POLAR.get(d.plane, ()))] = 1.0
    ground = d.tensor("Tendon ground", torch.tensor([-0.3, 0.2, 0.4]) + 0.02 * d.uniform(3))
    arm = d.tensor("Tendon arm", torch.tensor([0.0, 0.1, 0.15]) + 0.02 * d.uniform(3))
    pull = d.number("Tendon pull", 0.1, 0.2)

    def made(x):
        arms = inside * arm(x)
        eyelets = [(None, inside * ground(x)), (0, arms), (-1, arms)]
        if form == "tension":
            return tb.Tendon(eyelets, tension=pull(x))
        return tb.Tendon(eyelets, stiffness=pull(x), length=0.5 + pull(x))

    return made


def _inside(d, force, moment):
    """What lies in the scene's plane."""
    if d.plane is None:
        return force, moment
    normal = torch.tensor([0.0, 0, 1] if d.plane == "xy" else [0.0, 1, 0])
    return force * (1 - normal), moment * normal


def _load(d, sites):
    a = {
        n: d.tensor(f"Load {n}", 0.2 + 0.3 * d.uniform(3))
        for n in ("position", "rotation", "velocity", "spin", "time")
    }

    def made(x):
        k = {n: r(x)[..., None, :] if sites else r(x) for n, r in a.items()}

        def function(position, rotation, velocity, spin, t, **more):
            force = (
                -k["position"] * torch.sin(position)
                - k["velocity"] * velocity
                + k["time"] * torch.sin(3 * t)
            )
            moment = 0.3 * (rotation @ k["rotation"][..., None])[..., 0] - 0.1 * k["spin"] * spin
            for v in more.values():
                force = force + v * k["time"] * position
            return _inside(d, force, moment)

        return function

    return made


@ingredient("effect", "Load node")
def user_load(d):
    function, node = _load(d, False), d.pick(1, -1)
    return lambda x: tb.Load(function(x), node=node)


@ingredient("effect", "Load along")
def user_load_along(d):
    function = _load(d, True)
    return lambda x: tb.Load(function(x), node=None)


@ingredient("effect", "Load inputs", ("node", "along"))
def user_load_inputs(d, form):
    function = _load(d, form == "along")
    d.inputs["load_input"] = d.vector("load input", 0.5)
    return lambda x: tb.Load(
        function(x), node=-1 if form == "node" else None, inputs={"load_input": 3}
    )


@ingredient("effect", "Load of")
def user_load_of(d):
    k = d.tensor("Load stiffness", 0.5 + 0.5 * d.uniform(3))
    c = d.tensor("Load rate", 0.5 + d.uniform(3))
    of = d.pick(("position",), ("velocity",), ())

    def made(x):
        def function(position, rotation, velocity, spin, t):
            looked = (
                position
                if position is not None
                else velocity
                if velocity is not None
                else torch.ones(3)
            )
            return _inside(d, -k(x) * torch.cos(looked * (1 + c(x) * t)), torch.zeros(3))[0], None

        return function

    return lambda x: tb.Load(made(x), node=-1, of=of)


@ingredient("effect", "Load internal")
def user_load_internal(d):
    lag, gain = d.number("Load lag", 5.0, 10.0), d.tensor("Load gain", 0.5 + 0.5 * d.uniform(3))
    demand = d.tensor("Load demand", 0.5 + 0.5 * d.uniform(2))

    def made(x):
        def function(position, rotation, velocity, spin, t, z):
            return _inside(d, gain(x) * (z.sum(-1, keepdim=True) + 0.2 * velocity), torch.zeros(3))[
                0
            ], None

        def rate(z, position, rotation, velocity, spin, t):
            return (
                lag(x)[..., None] * (demand(x) * torch.cos(2 * t) - z * (1 + 0.1 * z))
                + position[..., :2]
            )

        return tb.Load(function, node=-1, internal=2, rate=rate)

    return made
