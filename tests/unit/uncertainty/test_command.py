"""python -m torchbeam montecarlo: configurations, processes, a cluster; stopped and taken up
again.
"""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Future
from types import SimpleNamespace

import pytest
import torch

import torchbeam as tb
from torchbeam.uncertainty.cluster import Cluster as Workers
from torchbeam.uncertainty.command import main
from torchbeam.uncertainty.config import read

MODEL = """
import time
from pathlib import Path
import torch
import torchbeam as tb

torch.set_default_dtype(torch.float64)
SHIFT = 1.0
HERE = Path(__file__).parent

def function(theta):
    while (HERE / "hold").exists() and len([*HERE.glob("{held}/samples/chunk-*.pt")]) >= {most}:
        time.sleep(0.01)
    return theta.prod(-1) + SHIFT * torch.ones(()), torch.where(theta[:, 0] > 1.9, 7, 0)

laws = {{"a": (0.0, 2.0), "b": tb.laws.Normal(1.0, 0.2)}}
n = 512
replicates, chunk, sentences = 8, 16, {{7: "buckled"}}
thresholds = (2.5,)
"""


@pytest.fixture
def model(tmp_path, request):
    """A configuration whose name no other test has loaded. As long as a file "hold" stands beside
    it, the run into the folder `held` computes nothing more once it has so many chunks.
    """

    def write(held="", most=0, **changed):
        path = tmp_path / f"model_{request.node.name.partition('[')[0]}.py"
        text = MODEL.format(held=held, most=most)
        path.write_text(text + "\n".join(f"{name} = {value!r}" for name, value in changed.items()))
        return path

    yield write
    for name in [name for name in sys.modules if name.startswith("model_")]:
        del sys.modules[name]
    sys.path[:] = [path for path in sys.path if path != str(tmp_path)]


def summary(folder):
    return json.loads((folder / "summary.json").read_text())


def test_python(model, tmp_path, capsys):
    """The numbers are those of the function's own call; files and table; a second call computes
    nothing.
    """
    path = model()
    assert main([str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    config = read(path)
    wanted = tb.monte_carlo(config.function, config.laws, 512, replicates=8)
    found = summary(tmp_path / "out")
    assert found["statistics"][0]["estimate"] == wanted.mean.item() and found["reasons"] == {
        "buckled": wanted.failed
    }
    printed = capsys.readouterr().out
    beyond = next(row for row in found["statistics"] if row["quantity"] == "P(y > 2.5)")
    assert [beyond[key] for key in ("estimate", "low", "high")] == [
        x.item() for x in wanted.exceedance(2.5)
    ]
    assert (
        "P(y > 2.5)" in printed
        and "quantile 0.95" in printed
        and (tmp_path / "out" / "summary.csv").exists()
    )
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "out" / "samples").glob("chunk*")}
    assert len(before) == 32
    assert main([str(path), "--out", str(tmp_path / "out")]) == 0
    assert {
        p: p.stat().st_mtime_ns for p in before
    } == before and "512 were there" in capsys.readouterr().err


@pytest.mark.parametrize("ending", ["json", "toml"])
def test_text(model, tmp_path, ending, monkeypatch):
    """Laws by name, a correlation by pairs, a stream."""
    model()
    if ending == "json":
        text = json.dumps(
            {
                "function": "model_test_text.py:function",
                "n": 512,
                "keep": False,
                "replicates": 8,
                "dtype": "float64",
                "laws": {"a": [0, 2], "b": {"law": "normal", "mean": 1, "deviation": 0.2}},
                "correlation": {"a, b": 0.5},
                "sentences": {"7": "buckled"},
            }
        )
    else:
        pytest.importorskip("tomllib")
        text = (
            'function = "model_test_text.py:function"\nn = 512\nkeep = false\nreplicates = '
            '8\ndtype = "float64"\n[laws]\na = [0, 2]\nb = {law = "normal", mean = 1, deviation = '
            '0.2}\n[correlation]\n"a,b" = 0.5\n[sentences]\n7 = "buckled"\n'
        )
    path = tmp_path / f"run.{ending}"
    path.write_text(text)
    assert main([str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    laws = {"a": (0.0, 2.0), "b": tb.laws.Normal(1.0, 0.2)}
    wanted = tb.monte_carlo_stream(
        read(path).function, laws, 512, replicates=8, correlation={("a", "b"): 0.5}
    )
    found = summary(tmp_path / "out")
    assert found["statistics"][0]["estimate"] == wanted.mean.item() and list(found["reasons"]) == [
        "buckled"
    ]


def config(**changed):
    """run.json and its text; what is None is left out."""
    whole = {"function": "torch:sin", "laws": {"a": [0, 1]}, "n": 16, **changed}
    return "run.json", json.dumps(
        {name: value for name, value in whole.items() if value is not None}
    )


BAD = {
    "not there": ("none.json", None, "which is not there"),
    "ending": ("run.txt", "", "ends in .py, .json or .toml"),
    "no JSON": ("run.json", "{", "run.json cannot be read"),
    "a list": ("run.json", "[]", "holds a list"),
    "unknown": (*config(n=None, samples=3), "'samples' was given in run.json"),
    "no laws": (*config(laws=None), "run.json without laws"),
    "no function": (*config(function="sin"), '"FILE.py:NAME" or "MODULE:NAME"'),
    "no file": (*config(function="no.py:f"), "is not there"),
    "no module": (*config(function="nomodule.x:f"), "is not there"),
    "no such function": (*config(function="math:f"), "'math' has no 'f'"),
    "law": (*config(laws={"a": {"law": "x"}}), "one of constant"),
    "dtype": (*config(dtype="half"), "float32 or float64"),
    "no n": (*config(n=None), "without n was given"),
    "levels": (*config(levels=0.5), "levels = 0.5 was given; a list of numbers"),
    "no probabilities": (
        *config(levels=[5, 95]),
        "levels = (5.0, 95.0) were given in run.json; prob",
    ),
    "thresholds": (*config(thresholds=["x"]), "'x' was given; numbers"),
    "interval": (*config(interval=95), "interval = 95 was given; a probability between 0 and 1"),
    "keep": (*config(keep="no"), "keep = 'no' was given"),
    "sentences": (*config(sentences={"x": "buckled"}), "a dict, status -> text, is wanted"),
    "a name of another": ("json.py", "n = 1", "another module is called 'json'"),
    "of a stream": (*config(keep=False, until=0.1), "'until' was given with keep = False"),
}


@pytest.mark.parametrize("name", BAD)
def test_refused(name, tmp_path, capsys):
    file, text, sentence = BAD[name]
    if text is not None:
        (tmp_path / file).write_text(text)
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / file), "--out", str(tmp_path / "out"), "--quiet"])
    assert ended.value.code == 2 and sentence in capsys.readouterr().err


def test_no_samples(model, tmp_path, capsys):
    """--n 0 is not what the configuration says."""
    with pytest.raises(SystemExit):
        main([str(model()), "--out", str(tmp_path / "out"), "--quiet", "--n", "0"])
    assert "n = 0 was given" in capsys.readouterr().err


def command(path, out, *further):
    code = "import sys; from torchbeam.uncertainty.command import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, str(path), "--out", str(out), *further],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.long
def test_processes_of_which_one_is_killed(model, tmp_path):
    """Two workers; one is killed with SIGKILL, then the command itself; the same command ends with
    the same numbers.
    """
    path, hold = model("killed", 12), tmp_path / "hold"
    assert ended(command(path, tmp_path / "whole", "--workers", "2"))[0] == 0
    hold.touch()
    process = command(path, tmp_path / "killed", "--workers", "2")
    until(lambda: chunks(tmp_path / "killed") >= 4, process)
    workers = [int(x) for x in children(process.pid) if "spawn_main" in cmdline(x)]
    os.kill(workers[0], signal.SIGKILL)
    until(lambda: chunks(tmp_path / "killed") >= 12, process)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert 12 <= chunks(tmp_path / "killed") < 32
    hold.unlink()
    code, said = ended(command(path, tmp_path / "killed", "--workers", "2"))
    assert code == 0 and "were there" in said
    assert summary(tmp_path / "killed")["statistics"] == summary(tmp_path / "whole")["statistics"]


@pytest.mark.long
def test_cluster(model, tmp_path):
    """Dask's own programs: one worker is killed with SIGKILL, one joins late, then the scheduler is
    lost; the run is resumed with a new one: the same numbers as without any of that.
    """
    pytest.importorskip("distributed")
    path, hold = model("lost", 14), tmp_path / "hold"
    assert ended(command(path, tmp_path / "whole", "--quiet"))[0] == 0
    hold.touch()
    with Cluster(tmp_path, 1) as cluster:
        process = command(path, tmp_path / "lost", "--scheduler", cluster.address)
        until(lambda: chunks(tmp_path / "lost") >= 3, process)
        cluster.add()  # joins late
        until(lambda: chunks(tmp_path / "lost") >= 8, process)
        cluster.workers[0].kill()
        until(lambda: chunks(tmp_path / "lost") >= 14, process)
        cluster.scheduler.kill()
        code, said = ended(process)
        assert code == 1 and "goes on where it was" in said
    hold.unlink()
    assert 14 <= chunks(tmp_path / "lost") < 32
    with Cluster(tmp_path, 2) as cluster:
        again = command(path, tmp_path / "lost", "--scheduler", str(cluster.file))
        code, said = ended(again)
        assert code == 0, said
    assert summary(tmp_path / "lost")["statistics"] == summary(tmp_path / "whole")["statistics"]


class Cluster:
    """A scheduler and workers, each a process of its own, as on several hosts."""

    def __init__(self, folder, workers):
        self.file = folder / f"scheduler-{time.monotonic_ns()}.json"
        self.scheduler = self._begin(
            "scheduler", "--scheduler-file", self.file, "--port", "0", "--no-dashboard", "--host",
            "127.0.0.1",
        )  # fmt: skip
        until(self._address, self.scheduler)
        self.address = self._address()
        self.workers = []
        for _ in range(workers):
            self.add()

    def _address(self):
        """None as long as the file is not written whole."""
        try:
            return json.loads(self.file.read_text())["address"]
        except (OSError, ValueError):
            return None

    def add(self):
        self.workers.append(
            self._begin("worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
        )

    def _begin(self, *words):
        return subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_" + words[0], *map(str, words[1:])],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def test_no_scheduler(model, tmp_path, capsys, monkeypatch):
    """A scheduler's file that never comes is not waited for without end."""
    pytest.importorskip("distributed")
    monkeypatch.setattr("torchbeam.uncertainty.cluster.BEGINNING", 0.0)
    monkeypatch.setattr("torchbeam.uncertainty.cluster.POLL", 0.0)
    assert (
        main(
            [
                str(model()),
                "--out",
                str(tmp_path / "out"),
                "--quiet",
                "--scheduler",
                str(tmp_path / "scheduler.json"),
            ]
        )
        == 1
    )
    assert "no scheduler has written the file" in capsys.readouterr().err


def test_a_chunk_that_kills_its_workers():
    """Dask gives up after some of them: an error of lost workers, with the samples that it was
    about.
    """
    killed = pytest.importorskip("distributed.scheduler").KilledWorker
    future = Future()
    future.set_exception(killed("a task", SimpleNamespace(address="tcp://host:1"), 3))
    client = SimpleNamespace(
        get_executor=lambda **options: SimpleNamespace(submit=lambda job: future)
    )
    with pytest.raises(BrokenExecutor, match=r"^samples 16 to 31 were on 4 workers that died$"):
        Workers(client, killed).submit(SimpleNamespace(first=16, last=32)).result()


def chunks(folder):
    return len(list(folder.glob("samples/chunk-*.pt")))


def until(true, process):
    """However long that takes, as long as the process is there."""
    while not true():
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.02)


def ended(process):
    """Its exit status and what it said."""
    said = process.communicate()[1]
    return process.returncode, said


def children(pid):
    with open(f"/proc/{pid}/task/{pid}/children") as file:
        return file.read().split()


def cmdline(pid):
    with open(f"/proc/{pid}/cmdline") as file:
        return file.read()


def test_a_folder_that_workers_do_not_see(tmp_path):
    """A worker on another machine: the caller writes its chunks; the dtype there is the
    caller's.
    """
    from dataclasses import replace

    class Elsewhere:
        def submit(self, job):
            future = Future()
            nowhere = replace(job.work.folder, path=tmp_path / "nowhere")
            work = replace(job.work, folder=nowhere)
            there = replace(job, work=work, caller=("another", 1))
            torch.set_default_dtype(torch.float32)
            future.set_result(there())
            return future

    laws = {"a": (0.0, 1.0), "b": (0.0, 1.0)}
    found = tb.monte_carlo(
        lambda theta: theta * torch.ones(2), laws, 64, chunk=16, out=tmp_path / "run",
        executor=Elsewhere(),
    )  # fmt: skip
    assert found.y.dtype == torch.float64 and len(list((tmp_path / "run").glob("chunk*"))) == 4
    assert not (tmp_path / "nowhere").exists()
