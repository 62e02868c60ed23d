"""Room of what changes in native code, whatever acts between nodes; what it gives: see
properties/test_parity.py.
"""

import torch

import torchbeam as tb
from torchbeam.engine.chain import native
from torchbeam.engine.chain.adjoint import AdjointProgram
from torchbeam.engine.chain.program import StepProgram


def test_what_changes_has_the_room_of_a_strain(monkeypatch):
    """Forwards and in the adjoint, whatever acts between nodes."""
    room = {}

    def watched(made, name):
        lay = made._layout

        def laid(self):
            layout = lay(self)
            room[name] = layout.fields("change")[name][1]
            return layout

        monkeypatch.setattr(made, "_layout", laid)

    monkeypatch.setattr(native, "stored_layout", lambda key: None)
    watched(StepProgram, "stress")
    watched(AdjointProgram, "gap_bar")
    section = tb.Section.circle(0.01, 1e7, 0.3, 1e3)
    floor = tb.Contact(tb.Plane((0, 0, -1.0), (0, 0, 1.0)), radius=0.01, thickness=1e-2, force=1.0)
    pull = torch.tensor(0.5, requires_grad=True)
    tip = tb.TipLoad(moment=pull * torch.tensor([0.0, 1.0, 0.0]))
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [floor, tip], plane="xz")
    t = torch.tensor([0.0, 2e-3])
    solution = tb.simulate(scene, t, step=1e-3, method="generalized_alpha", engine="compiled")
    solution.tip.position[-1].sum().backward()
    assert room == {"stress": 3, "gap_bar": 3}
