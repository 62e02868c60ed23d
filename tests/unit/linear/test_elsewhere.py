"""A linear model elsewhere: what files and python-control hold is the model."""

import numpy as np
import pytest
import torch

import torchbeam as tb

DT = 0.02  # s
SECTION = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)


def model(batch=()):
    """A clamped strip in a plane, with a force at its tip and a couple in its middle."""
    beam = tb.Beam.straight(1.0, 2, SECTION)
    loads = [
        tb.TipLoad(force=tb.Input("push", 3)),
        tb.PointLoad(1, moment=tb.Input("couple", 3)),
        tb.Damping(torch.full(batch, 1e-2)),
    ]
    zero = {"push": (0.0, 0, 0), "couple": (0.0, 0, 0)}
    return tb.linearize(
        tb.Scene(beam, loads, plane="xz"), outputs=tb.sensors.TipPosition(), inputs=zero
    )


def read(path):
    """Arrays and names of a file."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            content = dict(file)
        return content, content.pop("inputs").tolist()
    content = pytest.importorskip("scipy.io").loadmat(path)
    content = {name: value for name, value in content.items() if not name.startswith("__")}
    return content, [str(cell[0]) for cell in content.pop("inputs").ravel()]


@pytest.mark.parametrize("ending", [".npz", ".mat"])
def test_a_loop_of_numpy_by_the_file_moves_as_the_model_does(ending, tmp_path):
    """25 steps of it from rest under a force: what another program makes of the file."""
    digital = model().discrete(DT)
    path = digital.save(tmp_path / f"strip{ending}", K=torch.ones(2, digital.A.shape[-1]), mass=0.5)
    content, names = read(path)
    assert names == [*(f"push[{i}]" for i in range(3)), *(f"couple[{i}]" for i in range(3))]
    assert content["dt"].item() == DT and content["mass"].item() == 0.5
    assert content["K"].shape == (2, digital.A.shape[-1])
    assert np.allclose(content["reads"], digital.reads, rtol=0, atol=0)
    u, z = np.array([0, 0, 0.1, 0, 0, 0]), np.zeros(digital.A.shape[-1])
    for _ in range(25):
        z = content["A"] @ z + content["B"] @ u
    y = content["C"] @ z + content["D"] @ u + content["output"].ravel()
    expected = torch.zeros(len(z), dtype=torch.float64)
    for _ in range(25):
        expected = digital.A @ expected + digital.B @ torch.as_tensor(u)
    tip = digital.output + digital.C @ expected + digital.D @ torch.as_tensor(u)
    assert abs(tip[2]) > 0.01 and np.abs(y - tip.numpy()).max() < 1e-12


@pytest.mark.parametrize("ending", [".npz", ".mat"])
@pytest.mark.parametrize("batch", [(), (3,)])
def test_a_model_comes_back_from_its_file_to_the_last_digit(ending, batch, tmp_path):
    """All numbers and names, gains of float32, and what follows from the mass; no state."""
    pytest.importorskip("scipy")
    whole, K = model(batch), torch.rand(2, 12)
    for saved in (whole, whole.reduced(2, static=True).discrete(DT)):
        path = saved.save(tmp_path / f"strip{ending}", K=K, gate=0.5)
        again, more = tb.Linear.load(path)
        for name in ("A", "B", "C", "D", "output", "reads", "mass"):
            ours, theirs = getattr(saved, name), getattr(again, name)
            assert (ours is None and theirs is None) or torch.equal(ours, theirs)
        for name in ("dt", "inputs", "readings", "arms"):
            assert getattr(again, name) == getattr(saved, name)
        assert list(more) == ["K", "gate"] and torch.equal(more["K"], K) and more["gate"] == 0.5
        assert torch.equal(again.response(3.0), saved.response(3.0))
        with pytest.raises(ValueError, match="model of linearize is wanted"):
            again.departure(whole.state)
    again, _ = tb.Linear.load(whole.save(tmp_path / f"whole{ending}"))
    assert torch.equal(again.reduced(2).A, whole.reduced(2).A)


@pytest.mark.parametrize("ending", [".npz", ".mat"])
def test_other_files_are_no_linear_models(ending, tmp_path):
    path = tmp_path / f"other{ending}"
    with pytest.raises(ValueError, match="cannot be read"):
        tb.Linear.load(path)
    path.write_bytes(b"no archive")
    with pytest.raises(ValueError, match="no linear model"):
        tb.Linear.load(path)
    with open(path, "wb") as file:
        if ending == ".npz":
            np.savez(file, A=np.eye(2))
        else:
            pytest.importorskip("scipy.io").savemat(file, dict(A=np.eye(2)))
    with pytest.raises(ValueError, match="no linear model"):
        tb.Linear.load(path)
    with pytest.raises(ValueError, match=r"Linear.load.* is wanted"):
        tb.load(path)


def test_a_file_whose_arrays_belong_to_no_model_is_refused(tmp_path):
    """Arrays that are shorter, of other numbers or of words; names that are too few."""
    path = model().save(tmp_path / "strip.npz")
    with pytest.raises(ValueError, match="'M' was given to save"):
        model().discrete(DT).save(path, M=1.0)
    with np.load(path, allow_pickle=False) as file:
        content = dict(file)
    A, B, C = (content[name] for name in "ABC")
    assert {*content} == {*"ABCDM", "dt", "output", "reads", "arms", "inputs", "readings"}
    cases = [(name, x[1:] if x.ndim else np.ones(2)) for name, x in content.items()]
    cases += [("A", A[:, 1:]), ("A", A * np.nan), ("A", np.rint(A).astype(int)), ("dt", -1.0)]
    cases += [("B", B.astype("f4")), ("C", C.astype("U9")), ("arms", 1), ("reads", np.eye(3))]
    for changes, fits in [({}, True), *(({name: other}, False) for name, other in cases)]:
        np.savez(path, **(content | changes))
        if fits:
            assert (tb.Linear.load(path)[0].A == model().A).all()
            continue
        with pytest.raises(ValueError, match="no linear model of this version; one that"):
            tb.Linear.load(path)


@pytest.mark.parametrize("ending", [".npz", ".mat"])
def test_names_that_writers_have_arguments_of(ending, tmp_path):
    more = {"file": (1.0, 2.0), "allow_pickle": 3.0, "arr_0": 4.0, "appendmat": 5.0}
    content, _ = read(model().save(tmp_path / f"strip{ending}", **more))
    assert all(np.array_equal(content[name].ravel(), np.ravel(more[name])) for name in more)


def test_a_batch_goes_into_a_file_whole(tmp_path):
    several = model((3,))
    content, _ = read(several.save(tmp_path / "several.npz"))
    assert content["A"].shape == (3, 12, 12) and content["dt"] == 0
    assert np.array_equal(content["A"], several.A)


@pytest.mark.parametrize(
    "path, more, sentence",
    [
        ("strip.csv", {}, "ends in .npz or .mat"),
        ("nowhere/deeper/strip.npz", {}, "folder"),
        ("strip.npz", {"A": 1.0}, "'A' was given to save"),
        ("strip.npz", {"inputs": 1.0}, "'inputs' was given to save"),
        ("strip.npz", {"a-b": 1.0}, "letters, digits"),
        ("strip.npz", {"_hidden": 1.0}, "letters, digits"),
        ("strip.npz", {"n" * 32: 1.0}, "letters, digits"),
        ("strip.mat", {"µ": 1.0}, "letters, digits"),
    ],
)
def test_what_no_file_can_hold_is_refused(path, more, sentence, tmp_path):
    with pytest.raises(ValueError, match=sentence):
        model().save(tmp_path / path, **more)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("sampled", [False, True])
def test_python_control_answers_as_the_model_does(sampled):
    """Frequency response from each input to each reading."""
    pytest.importorskip("control")
    own = model().discrete(DT) if sampled else model()
    system = own.to_control()
    omega = torch.tensor([0.5, 5.0, 40.0], dtype=torch.float64)
    s = 1j * omega if not sampled else torch.exp(1j * omega * DT)
    ours, theirs = own.response(omega), np.moveaxis(system(s.numpy()), -1, 0)
    assert system.dt == (DT if sampled else 0) and system.input_labels[4] == "couple[1]"
    assert np.abs(theirs - ours.numpy()).max() < 1e-9 * ours.abs().max()


@pytest.mark.parametrize("plane, turn", [(None, "turn y"), ("xz", "turn")])
def test_python_control_knows_states_and_readings_by_name(plane, turn):
    """What a name says is what its number is: a move of the tip along z is read by the sensor of
    that name, one along x by another; of a reduced model, and of a function, there are places.
    """
    pytest.importorskip("control")
    beam = tb.Beam.straight(1.0, 2, SECTION)
    gauge = tb.sensors.Gauge(0.05, beam, z=0.001)
    tip = tb.sensors.TipPosition()
    push = tb.TipLoad(force=tb.Input("arm.push", 3))
    linear = tb.linearize(
        tb.Scene(beam, push, plane=plane),
        outputs=(tip, gauge, tip["x"], lambda state: state.tip.position),
        inputs={"arm.push": (0.0, 0, 0)},
    )
    system = linear.to_control()
    assert system.input_labels == [f"arm,push[{k}]" for k in range(3)]
    assert system.output_labels == [
        *("tip position x[0]", "tip position y", "tip position z", "gauge at 0,05 m strain"),
        *("tip position x[4]", "y[5]", "y[6]", "y[7]"),
    ]
    states = system.state_labels
    assert f"node 2 {turn}" in states and len(set(states)) == len(states)
    for axis, row in (("x", 0), ("z", 2)):
        at = states.index(f"node 2 {axis}")
        assert system.C[row, at] == 1 and system.A[at, states.index(f"node 2 {axis} rate")] == 1
    assert linear.reduced(1).to_control().state_labels == ["z[0]", "z[1]"]


def test_python_control_takes_no_batch():
    with pytest.raises(ValueError, match=r"batch axes \(3,\)"):
        model((3,)).to_control()
