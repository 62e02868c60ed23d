"""Ingredients of the gradient fuzz: supports, and motions of the root and of frame a."""

import torch

import torchbeam as tb
from tests.cases.gradient_ingredients import ingredient

# Supports: a reader of a tuple of supports, beside a clamp at node 0 or in its place


def _position(d):
    return d.pick("x", "y", "z", "xy", "xz", "yz", "xyz", "xyz")


HELD = ("nothing", "xy", "xz", "yz", "xyz")  # of the rotation


@ingredient("supports", "tip held", HELD)
def tip_held(d, rotation):
    position, rotation = d.pick("", _position(d), _position(d)), rotation.replace("nothing", "")
    if not position + rotation:
        position = "y"
    return lambda x: (tb.Support(0), tb.Support(-1, position, rotation))


@ingredient("supports", "root held", HELD[:4])
def root_held(d, rotation):
    rotation = rotation.replace("nothing", "")
    return lambda x: (
        tb.Support(0, "xyz", rotation),
        tb.Support(-1, "xyz" if rotation == "" else "yz", "yz"),
    )


@ingredient("supports", "inner node held", HELD)
def inner_held(d, rotation):
    position, node = _position(d), d.pick(1, -2)
    return lambda x: (tb.Support(0), tb.Support(node, position, rotation.replace("nothing", "")))


MOTIONS = ("value", "list", "function", "tuple")


@ingredient("supports", "tip displaced", MOTIONS)
def tip_displaced(d, form):
    u, position = d.value("tip displacement", 0.03, form), _position(d)
    rotation = d.pick("", "xy", "xz", "yz", "xyz")
    return lambda x: (tb.Support(0), tb.Support(-1, position, rotation, displacement=u(x)))


@ingredient("supports", "tip turned", MOTIONS)
def tip_turned(d, form):
    turn, position = d.value("tip turn", 0.1, form, axial=True), d.pick("", "x", "yz", "xyz")
    return lambda x: (tb.Support(0), tb.Support(-1, position, "xyz", turn=turn(x)))


@ingredient("supports", "hinge displaced", MOTIONS)
def hinge_displaced(d, form):
    u, rotation = d.value("hinge displacement", 0.03, form), d.pick("", "xy", "xz", "yz")
    return lambda x: (
        tb.Support(0, "xyz", rotation, displacement=u(x)),
        tb.Support(-1, "xyz", "yz"),
    )


@ingredient("supports", "inner node displaced and turned", MOTIONS)
def inner_moved(d, form):
    u = d.value("inner displacement", 0.03, form)
    turn = d.value("inner turn", 0.1, form, axial=True)
    return lambda x: (tb.Support(0), tb.Support(1, "xyz", "xyz", displacement=u(x), turn=turn(x)))


@ingredient("supports", "clamp displaced and turned", MOTIONS)
def clamp_moved(d, form):
    u = d.value("clamp displacement", 0.03, form)
    turn = d.value("clamp turn", 0.1, form, axial=True)
    return lambda x: (tb.Support(0, displacement=u(x), turn=turn(x)),)


@ingredient("supports", "free")
def free(d):
    return lambda x: ()


# Motions of frame a and of the root


@ingredient("frame", "Frame velocity", MOTIONS)
def frame_velocity(d, form):
    v = d.value("frame velocity", 0.5, form)
    return lambda x: tb.Frame(velocity=v(x))


@ingredient("frame", "Frame angular_velocity", MOTIONS)
def frame_turns(d, form):
    omega = d.value("frame angular_velocity", 0.8, form, axial=True)
    return lambda x: tb.Frame(angular_velocity=omega(x))


@ingredient("frame", "Frame both", MOTIONS)
def frame_both(d, form):
    v = d.value("frame velocity", 0.5, form)
    omega = d.value("frame angular_velocity", 0.8, form, axial=True)
    return lambda x: tb.Frame(velocity=v(x), angular_velocity=omega(x))


@ingredient("root", "RootMotion displacement", MOTIONS)
def root_displaced(d, form):
    u = d.value("root displacement", 0.05, form)
    return lambda x: tb.RootMotion(displacement=u(x))


@ingredient("root", "RootMotion rotation", MOTIONS)
def root_turned(d, form):
    turn = d.value("root rotation", 0.2, form, axial=True)
    return lambda x: tb.RootMotion(rotation=turn(x))


@ingredient("root", "RootMotion both", MOTIONS)
def root_both(d, form):
    u = d.value("root displacement", 0.05, form)
    turn = d.value("root rotation", 0.2, form, axial=True)
    return lambda x: tb.RootMotion(displacement=u(x), rotation=turn(x))


@ingredient("root", "Accelerogram")
def accelerogram(d):
    t = d.tensor(
        "accelerogram t", torch.tensor([-0.3, 0.11, 0.245, 0.375, 2.0]), size=0.05, alone=True
    )
    a = d.vector("accelerogram acceleration", 2.0, False, 5)
    return lambda x: tb.RootMotion(displacement=tb.Accelerogram(t(x), a(x)))
