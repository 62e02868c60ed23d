"""python -m studies: measurements of the library, each a command, from a clone of its source."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint

from torchbeam.core.command_line import run_command

MODULES = {
    "accuracy": "accuracy", "bench": "bench.command", "control": "error_control",
    "convergence": "convergence", "coverage": "uncertainty.coverage", "effects": "effect_costs",
    "estimation": "estimation", "gradients": "gradient_costs", "hardcases": "hard_cases.command",
    "house": "house", "identification": "identification", "noise": "noise_coverage",
    "oracle": "oracle.command", "peers": "peers", "rates": "rates", "scale": "uncertainty.scale",
    "verify": "verification.command",
}  # fmt: skip
COMMANDS = {
    name: EntryPoint(name, f"studies.{module}:main", "studies") for name, module in MODULES.items()
}


def main(argv: list[str] | None = None) -> int:
    """The command line `argv` (default: the process's); returns the exit status."""
    about = "Measurements of torchbeam: accuracy, verification, speed, coverage."
    return run_command("python -m studies", about, COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
