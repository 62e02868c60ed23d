"""torchbeam's local functions of one element and one node, as the compiled engine traces them, with
inputs to try them on.
"""

import ctypes
from math import prod

import torch

from torchbeam.engine.compiler.library import Library
from torchbeam.engine.compiler.llvm import Module
from torchbeam.equations.step_element import Ends, MidpointElement
from torchbeam.equations.step_kinematics import MidpointMotion, MidpointTangent
from torchbeam.nodal.constitutive_law import ViscoelasticLaw
from torchbeam.nodal.coordinates.planar import Planar
from torchbeam.nodal.coordinates.spatial import Spatial
from torchbeam.nodal.frame import TranslatingFrame, TurningFrame
from torchbeam.nodal.inertia import Inertia
from torchbeam.nodal.mass import LumpedMass, RotaryInertia
from torchbeam.nodal.mass_offset import MassOffset
from torchbeam.state.state import State
from torchbeam.topology.framework import Framework

torch.set_default_dtype(torch.float64)


def space_of(kind):
    return (
        Spatial()
        if kind == "space"
        else Planar("xy", torch.eye(3), torch.eye(3), torch.tensor(0.0))
    )


def rotations(space, *lead, turn=0.4):
    """Random rotations by about `turn` rad."""
    return space.exponential(turn * torch.randn(*lead, space.dims.spin))


def element_of(space):
    """A midpoint element: forces, gap, and its tangent."""

    def element(
        r_i,
        r_j,
        q_i,
        q_j,
        qe_i,
        qe_j,
        qs_i,
        qs_j,
        stress,
        length,
        h,
        reference,
        S,
        tau,
        half_i,
        half_j,
    ):
        law, start = ViscoelasticLaw(S, S, False, tau), Ends(-r_i, -r_j, qs_i, qs_j)
        local = MidpointElement(space, law, length, reference, 0.0, h, start, None)
        found = local.balance(stress, Ends(r_i, r_j, q_i, q_j), Ends(2 * r_i, 2 * r_j, qe_i, qe_j))
        return dict(
            forces=found.forces,
            gap=found.constitutive_residual,
            tangent=local.tangent(found, stress, lambda: (half_i, half_j)),
        )

    return element


def element_inputs(space, *lead):
    p, s, k = space.dims.position, space.dims.spin, space.dims.strain
    q = {
        name: rotations(space, *lead, 1) for name in ("q_i", "q_j", "qe_i", "qe_j", "qs_i", "qs_j")
    }
    one = {
        "r_i": (p,), "r_j": (p,), "stress": (k,), "reference": (k,), "S": (k, k), "half_i": (s, s),
        "half_j": (s, s),
    }  # fmt: skip
    others = {name: torch.randn(*lead, 1, *shape) for name, shape in one.items()}
    return {
        **q, **others, "length": 0.5 + torch.rand(*lead, 1, 1), "h": 0.1 + torch.rand(*lead, 1, 1),
        "tau": torch.rand(*lead, 1, 1, 1),
    }  # fmt: skip


def node_of(space):
    """A node of one midpoint step with an eccentric mass, in a frame that turns: its balance and
    tangent.
    """

    def node(mass, inertia, offset, position, rotation, velocity, spin, v, omega, h, u, m):
        state = State(position, rotation, velocity, spin, position, position, h, h, h, h)
        frame = TurningFrame(space, TranslatingFrame(space, v), omega)
        local = Inertia(
            space,
            LumpedMass(Framework(1, (0,)), mass),
            RotaryInertia(space, inertia),
            MassOffset(space, offset),
        )
        motion = MidpointMotion(local, state, h, frame, ())
        way = motion.kinematics(u, m)
        forces = motion.balance(way)
        return (
            forces.wrench,
            MidpointTangent(motion, way).inertia(forces).diagonal,
            way.velocity_end,
        )

    return node


def node_inputs(space, *lead):
    p, s = space.dims.position, space.dims.spin
    one = {
        "inertia": (s, s), "offset": (p,), "position": (p,), "velocity": (p,), "spin": (s,),
        "v": (p,), "omega": (s,), "u": (p,),
    }  # fmt: skip
    return {
        **{name: torch.randn(*lead, 1, *shape) for name, shape in one.items()},
        "mass": torch.rand(*lead, 1, 1),
        "h": 0.1 + torch.rand(*lead, 1, 1),
        "rotation": rotations(space, *lead, 1),
        "m": rotations(space, *lead, 1),
    }


def cases():
    """Name -> (function, inputs of one sample or of a batch, by its leading axes)."""
    return {
        f"{what} in a {kind}": (
            of(space_of(kind)),
            lambda *lead, kind=kind, given=given: given(space_of(kind), *lead),
        )
        for what, of, given in (
            ("element", element_of, element_inputs),
            ("node", node_of, node_inputs),
        )
        for kind in ("space", "plane")
    }


def native(function, inputs, dtype=torch.float64, cache=None, loaded=None):
    """A compiled function of (lanes, *shape) inputs. loaded: a dictionary that remembers the
    library.
    """
    lanes, loaded = next(iter(inputs.values())).shape[0], {} if loaded is None else loaded
    if not loaded:
        module = Module(lanes, dtype)
        module.define("traced", function)
        loaded |= {"library": Library(module.text(), cache), "lanes": lanes}
    library = loaded["library"]
    assert loaded["lanes"] == lanes  # it writes as many, whatever room there is
    records = [inputs[name].to(dtype).reshape(lanes, -1).T.contiguous() for name in function.inputs]
    found = {
        name: torch.full((len(out.nodes), lanes), torch.nan, dtype=dtype)
        for name, out in function.outputs.items()
    }
    sizes = [prod(record.shape[:1]) for record in (*records, *found.values())]
    assert [prod(shape) for shape in function.inputs.values()] == sizes[: len(records)]
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * len(sizes))(library.address("traced"))
    call(*(record.data_ptr() for record in (*records, *found.values())))
    return {name: x.T.reshape(lanes, *function.outputs[name].shape) for name, x in found.items()}
