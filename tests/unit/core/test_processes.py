"""Processes that work for this one end where it does."""

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
