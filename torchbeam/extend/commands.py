"""For those who write a command `python -m torchbeam NAME` (see `torchbeam.cli`), or measure and
write files.

`main`            the command line;  `threads`  so many threads of torch for a while
`results_folder`  the folder of an --out, or one sentence and status 2;  `folder`  the same of a
                  function
`measured_on`     machine, threads, dtype, versions;  `sentence`  them in words;  `versions`  of
                  packages
`table`           a Markdown table;  `csv_text`  rows as text;  `write_results`  name.md, .json and
                  .csv
`process_pool`    processes that end with this one
`write`, `save`, `written`  files that are there whole or not at all; `NotWritten` where the disk is
                            full
`measurement`     rows and repeated timings, for the entry points "torchbeam.benchmarks"
"""

from ..cli import main
from ..core import measurement
from ..core.command_line import results_folder, threads
from ..core.files import NotWritten, csv_text, folder, save, write, written
from ..core.processes import process_pool
from ..core.results import measured_on, sentence, table, versions
from ..core.results import write as write_results

# fmt: off
__all__ = [
    "NotWritten", "csv_text", "folder", "main", "measured_on", "measurement", "process_pool",
    "results_folder", "save",
    "sentence", "table", "threads", "versions", "write", "write_results", "written",
]
# fmt: on
