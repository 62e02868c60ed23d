"""Processes that work for this one end where it does."""

import os
import signal
import subprocess
import sys

import pytest

from torchbeam.core.processes import process_pool

SCRIPT = """
import time
from torchbeam.core.processes import process_pool

def wait(seconds):
    print("begun", flush=True)
    time.sleep(seconds)
    print("was not ended", flush=True)

if __name__ == "__main__":
    with process_pool(2) as pool:
        list(pool.map(wait, (600, 600)))
"""


def test_work_is_given_back():
    with process_pool(2) as pool:
        assert list(pool.map(abs, [-3, 2])) == [3, 2]


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("end", ["SIGKILL", pytest.param("SIGTERM", marks=pytest.mark.long)])
def test_they_end_with_the_process_that_started_them(tmp_path, end):
    """However it ends: else they wait for work for ever. Their end is that of what they print, as
    soon as the last of them has closed it.
    """
    (tmp_path / "script.py").write_text(SCRIPT)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py")], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert [parent.stdout.readline() for _ in range(2)] == ["begun\n"] * 2
        parent.send_signal(getattr(signal, end))
        assert parent.stdout.read() == ""


FORKED = """
import os, signal, sys
import torch, torchbeam
torch.set_num_threads(2)
x = torch.ones(1_000_000)
x.exp().sum()  # OpenMP has its threads
child = os.fork()
if not child:
    signal.alarm(20)  # it ends one that waits for ever
    x.exp().sum()
    os._exit(0 if torch.get_num_threads() == 1 else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="POSIX")
def test_a_forked_process_computes():
    """As gymnasium's AsyncVectorEnv and multiprocessing fork: OpenMP's threads stay behind, and an
    operation of torch that counts on them never ends.
    """
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    subprocess.run([sys.executable, "-c", FORKED], check=True, env=environment, timeout=120)
