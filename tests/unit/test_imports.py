"""What importing torchbeam, and using it, imports: no extra and no computer algebra before they are
needed, which would take seconds.
"""

import os
import subprocess
import sys

CODE = """
import sys, torchbeam as tb
section = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=1.0, mass=1.0, inertia=0.01)
scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [tb.Gravity((0, 0, -9.81))])
assert "matplotlib" not in sys.modules
tb.Stepper(scene, 0.01)  # by native code, once it steps
tb.describe(scene)
assert "llvmlite" not in sys.modules
tb.Stepper(scene, 0.01, engine="eager")(tb.rest(scene))
assert "sympy" not in sys.modules
"""


def test_extras_and_computer_algebra_are_imported_when_they_are_needed():
    """Importing no matplotlib, a stepper and `describe` no llvmlite, a step no sympy: in a process
    of their own.
    """
    env = {name: value for name, value in os.environ.items() if name != "TORCHBEAM_ENGINE"}
    subprocess.run([sys.executable, "-c", CODE], check=True, env=env, timeout=120)
