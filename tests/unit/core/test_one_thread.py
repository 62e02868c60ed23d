"""One thread for few numbers."""

import pytest
import torch

import torchbeam as tb
from torchbeam.core.one_thread import FEW, one_thread
from torchbeam.core.openmp import openmp
from torchbeam.statics import equilibrium


@pytest.mark.skipif(openmp() is None, reason="torch has no OpenMP that is called so")
def test_few_numbers_have_one_thread_many_have_all(monkeypatch):
    """And as many as before afterwards, whatever happens within."""
    library, before = openmp(), torch.get_num_threads()
    library.omp_set_num_threads(2)  # not torch's own: that would stay with MKL
    try:
        with pytest.raises(KeyError), one_thread(FEW):
            assert torch.get_num_threads() == 1
            raise KeyError
        assert torch.get_num_threads() == 2
        with one_thread(FEW + 1):
            assert torch.get_num_threads() == 2
        # an equilibrium: of a beam, and of a batch whose numbers are in its inputs
        seen, within = [], equilibrium._equilibrium
        monkeypatch.setattr(
            equilibrium,
            "_equilibrium",
            lambda *a: seen.append(torch.get_num_threads()) or within(*a),
        )
        section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
        load = tb.TipLoad(force=tb.Input("f", 3))
        scene = tb.Scene(tb.Beam.straight(1.0, 1, section), load)
        for samples in (1, FEW // 12 + 1):
            tb.equilibrium(scene, inputs={"f": torch.zeros(samples, 3)})
        assert seen == [1, 2]
        assert torch.get_num_threads() == 2
    finally:
        library.omp_set_num_threads(before)
