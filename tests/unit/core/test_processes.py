"""Processes that work for this one end where it does."""

import os
import signal
import subprocess
import sys
import time

import pytest

from torchbeam.core.processes import process_pool

SCRIPT = """
import os, time
from torchbeam.core.processes import process_pool

def wait(seconds):
    print(os.getpid(), flush=True)
    time.sleep(seconds)

if __name__ == "__main__":
    with process_pool(2) as pool:
        list(pool.map(wait, (60, 60)))
"""


def test_work_is_given_back():
    with process_pool(2) as pool:
        assert list(pool.map(abs, [-3, 2])) == [3, 2]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("end", ["SIGKILL", "SIGTERM"])
def test_they_end_with_the_process_that_started_them(tmp_path, end):
    """However it ends: else they wait for work for ever."""
    (tmp_path / "script.py").write_text(SCRIPT)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py")], stdout=subprocess.PIPE, text=True
    ) as parent:
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        parent.send_signal(getattr(signal, end))
        parent.wait()
        deadline = time.monotonic() + 20
        while any(map(alive, workers)):
            assert time.monotonic() < deadline
            time.sleep(0.05)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as file:  # one that has ended may not have been taken note of
        return file.read().rsplit(")", 1)[1].split()[0] != "Z"
