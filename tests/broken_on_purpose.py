"""What the parity net is worth: the library broken on purpose, a line at a time, which a row of it
has to find.  python -m tests.broken_on_purpose
"""

import importlib
import inspect
import os
import sys
import tempfile
import textwrap
from typing import NamedTuple

import torch


class Break(NamedTuple):
    """what: as it is told; place: module and function; was, is_: a part of its text, broken; name,
    ask: the row that finds it.
    """

    what: str
    place: str
    was: str
    is_: str
    name: str
    ask: str = "steps"


CHAIN = "torchbeam.engine.chain"
# fmt: off
BREAKS = [
    Break("work of a tendon of the wrong sign",
          f"{CHAIN}.tendon_functions:TendonFunctions.finish", "-mean", "mean", "tendons"),
    Break("blocks of interactions not swapped in the transposed matrix",
          f"{CHAIN}.interaction_functions:transposed", "name[::-1]", "name", "tendons"),
    Break("work of a joint forgotten", f"{CHAIN}.joint_functions:JointFunctions.finish",
          "after.work}", "0 * after.work}", "bodies"),
    Break("effort of a driven joint forgotten",
          f"{CHAIN}.joint_functions:JointFunctions.solution",
          "+ joints.held", "+ 0 * joints.held", "all_joints"),
    Break("blocks of interactions not transposed in the adjoint",
          f"{CHAIN}.interaction_functions:transposed", "block.mT for", "block for", "tree"),
    Break("work of a contact pair of the wrong sign",
          f"{CHAIN}.pair_functions:PairFunctions.finish", '": problem', '": -problem',
          "rubbing"),
    Break("swapped columns: cotangents of an interaction's ends",
          f"{CHAIN}.adjoint_driver:AdjointDriver._balances", "row.nodes[side])",
          "[*row.nodes.values()][-1 - [*row.nodes].index(side)])", "rubbing"),
    Break("a taper forgotten in pairs", f"{CHAIN}.pair_functions:PairFunctions.problem",
          "if not kind.has_taper:", "if True:", "taper_on_itself"),
    Break("work of a load between nodes of the wrong sign",
          f"{CHAIN}.local_functions:LocalFunctions.finish_element_load", '"work": problem',
          '"work": -problem', "on_a_ball"),
    Break("half of a node's work", f"{CHAIN}.local_functions:LocalFunctions.finish_node",
          '"work": after.work}', '"work": 0.5 * after.work}', "line_loads"),
    Break("internal states that stay", f"{CHAIN}.local_functions:LocalFunctions.finish_node",
          "states.get(k, still[k])", "still[k]", "lags"),
    Break("rates of strains forgotten by generalized alpha",
          f"{CHAIN}.method_functions:AlphaFunctions.finish_element", "problem.straining(",
          "0 * problem.straining(", "damped_springs", "generalized_alpha"),
    Break("energy of strains forgotten where it is kept",
          f"{CHAIN}.method_functions:ConservingFunctions.finish_element", "rise + strain",
          "rise", "pushed_in_a_plane", "conserve"),
    Break("supports of an equilibrium ahead of the load",
          f"{CHAIN}.steady_functions:SteadyFunctions.place", "displacement, turn, load_factor)",
          "displacement, turn, 0.9 * load_factor)", "quadratic_at_rest", "equilibrium"),
    Break("supports of a path that stay", f"{CHAIN}.path_balance:_rate", "torch.ones_like(zero)",
          "torch.zeros_like(zero)", "led", "path"),
    # of eager steps alone, whose properties are asked of native ones
    Break("eager: off-diagonal blocks not swapped in the transposed matrix",
          "torchbeam.topology.elimination:transposed", "L.mT, U.mT", "U.mT, L.mT",
          "bow_in_a_plane"),
    Break("eager: nine tenths of a solution's derivative",
          "torchbeam.solvers.implicit_gradient:implicit_gradient", "c - c.detach()",
          "0.9 * (c - c.detach())", "bow_in_a_plane"),
]
# fmt: on


def broken(one: Break) -> None:
    """Replaces the function by what the changed text says."""
    path, _, name = one.place.partition(":")
    module = importlib.import_module(path)
    owner, _, attribute = name.rpartition(".")
    owner = getattr(module, owner) if owner else module
    text = textwrap.dedent(inspect.getsource(getattr(owner, attribute)))
    assert text.count(one.was) == 1, f"{one.what}: {one.was!r} is not once in {one.place}"
    made: dict = {}
    exec(compile(text.replace(one.was, one.is_), one.place, "exec"), vars(module), made)
    function = getattr(owner, attribute)
    for other in [owner, *(m for name, m in sys.modules.items() if name.startswith("torchbeam"))]:
        if vars(other).get(attribute) is function:  # where it is imported by its name, too
            setattr(other, attribute, made[attribute])


def found(one: Break | None, check) -> bool:
    """Whether check() fails in a process of its own, with this break and without kept programs."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
    code = 2
    try:
        os.environ["TORCHBEAM_CACHE"] = tempfile.mkdtemp()
        if one is not None:
            broken(one)
        code = 0
        check()
    except Exception as error:
        code = code or 1
        print(f"    {type(error).__name__}: {' '.join(str(error).split())[:160]}", flush=True)
    finally:
        os._exit(code)


def by_parity(one: Break) -> bool:
    from tests.conftest import QUICKLY
    from tests.properties import test_parity as net

    def check():
        with QUICKLY:
            if one.ask == "path":
                net.test_a_native_path_is_the_eager_one(one.name)
            else:
                net.test_native_code_gives_the_eager_answer(one.name, one.ask)

    return found(one, check)


def main() -> int:
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    chosen = [BREAKS[int(k)] for k in sys.argv[1:]] or BREAKS
    missed = []
    for one in chosen:
        print(one.what, flush=True)
        missed += [one.what] * (not by_parity(one))
    print(f"{len(chosen)} breaks, {len(missed)} of which no row finds: {missed}")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
