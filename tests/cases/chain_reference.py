"""The compiled step's pass over the chain in plain Python, one sample, from the same local functions: what the native driver
is written after.
"""

import torch

from torchbeam.dynamics.compiled.chain_constants import flattened
from torchbeam.dynamics.compiled.constants import Constants
from torchbeam.dynamics.compiled.local_functions import LocalFunctions
from torchbeam.dynamics.compiled.local_problem import NODE, Kinds, node_kinds
from torchbeam.dynamics.midpoint import MidpointUnknowns

SUMS = ("force", "moment", "strain", "left_force", "left_moment", "left_strain")


class Chain:
    """Newton's method for a `MidpointProblem` without batch axes."""

    def __init__(self, problem):
        model, self.problem = problem.model, problem
        constants = Constants(model)
        trees = constants.at(problem.dt, problem.t, problem.inputs)
        self.local, self.N, w = LocalFunctions(model, *trees), model.count, model.space.unknowns
        nodes, elements, common, _ = map(flattened, trees)
        self.common = {f"common.{k}": x for k, (x, _) in enumerate(common)}
        self.node = [{f"node.{k}": row(x, axes, j) for k, (x, axes) in enumerate(nodes)} | self.common
                     | {name: getattr(problem.start, name)[j] for name in NODE} for j in range(self.N + 1)]
        self.element = [{f"element.{k}": row(x, axes, j) for k, (x, axes) in enumerate(elements)} | self.common
                        for j in range(self.N)]
        self.kinds = Kinds.of(node_kinds(model, constants.loads))
        self.free, self.zero = model.constraints.moving.to(model.length), {"vector": torch.zeros(w), "block": torch.zeros(w, w)}
        self.unknown = [self.local.predictor(kind, **node) for kind, node in zip(self.kinds.nodes, self.node, strict=True)]
        self.stress = list(problem.start.stress)

    def ends(self, e):
        """Fields of an element."""
        found = dict(self.element[e])
        for side, j in (("i", e), ("j", e + 1)):
            found |= {f"{side}.{name}": x for name, x in (self.node[j] | self.unknown[j]).items() if name not in self.common}
        return found | {"stress": self.stress[e]}

    def iterate(self):
        """One iteration: (scaled residual before it, reactions)."""
        N, local, model = self.N, self.local, self.problem.model
        vector, block = self.zero["vector"], self.zero["block"]
        nothing = {"balance": vector, "asked": vector, "D": block, "inertia": vector}
        sums, rows, elements, left = dict.fromkeys(SUMS, torch.zeros(())), [], [], {**nothing, "L": block}
        ahead, y = block, vector
        for j in range(N + 1):
            given = {f"own.{name}": x for name, x in local.node(self.kinds.nodes[j], **self.node[j], **self.unknown[j]).items()}
            right = {**nothing, "U": block}
            if j < N:
                elements.append(local.element(self.kinds.elements[j], **self.ends(j)))
                right = {name[2:]: x for name, x in elements[j].items() if name[:2] == "i."} | {"U": elements[j]["U"]}
            given |= {f"left.{name}": x for name, x in left.items()} | {f"right.{name}": x for name, x in right.items()}
            held = bool((self.free[max(j - 1, 0):j + 2] == 0).any())
            if held:
                near = self.free[max(j - 1, 0)], self.free[j], self.free[min(j + 1, N)]
                given |= dict(zip(("free_before", "free_here", "free_after"), near, strict=True))
            rows.append(local.row(held, ahead=ahead, y=y, **given))
            ahead, y = rows[j]["ahead"], rows[j]["y"]
            for found in (rows[j], *elements[j:]):
                sums = {name: torch.maximum(x, found.get(name, x)) for name, x in sums.items()}
            if j < N:
                left = {name[2:]: x for name, x in elements[j].items() if name[:2] == "j."} | {"L": elements[j]["L"]}
        moves = [vector] * (N + 3)
        for j in reversed(range(N + 1)):
            moves[j + 1] = local.back(rows[j]["ahead"], rows[j]["y"], moves[j + 2])["move"]
        reactions = [local.reaction(rows[at]["rows"], rows[at]["asked"], self.free[at], *moves[at:at + 3])["reaction"]
                     for at in model.constraints.nodes]
        self.stress = [local.stress(stress, found["gap"], found["E"], moves[e + 1], moves[e + 2], **self.element[e])["stress"]
                       for e, (stress, found) in enumerate(zip(self.stress, elements, strict=True))]
        self.unknown = [local.update(kind, moves[j + 1], **self.node[j], **self.unknown[j])
                        for j, kind in enumerate(self.kinds.nodes)]
        zero, one = torch.zeros(()), torch.ones(())
        size = local.judge(**sums, total=model.length.sum(), longest=model.length.amax(), exact=one, tolerance=one, before=zero,
                           over=zero, done=zero, status=zero, iterations=zero)["before"]
        return size, torch.stack(reactions) if reactions else vector.new_zeros(0, len(vector))

    @property
    def x(self):
        return MidpointUnknowns(*(torch.stack([x[name] for x in self.unknown]) for name in "um"), torch.stack(self.stress))

    def finish(self):
        """Fields of the nodes at the end, and the work done."""
        found = [self.local.finish(kind, **node, **x)
                 for kind, node, x in zip(self.kinds.nodes, self.node, self.unknown, strict=True)]
        return {name: torch.stack([x[name] for x in found]) for name in NODE} | {"work": sum(x["work"] for x in found)}


def row(x, axes, j):
    """Of the node or element j; what all share has one row."""
    at = x.ndim - axes
    return x.select(at, j if x.shape[at] > 1 else 0)
