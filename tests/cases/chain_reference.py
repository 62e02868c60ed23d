"""The compiled step's pass over the chain in plain Python, one sample, from the same local
functions: what the native driver is written after.
"""

import torch

from torchbeam.engine.chain.chain_constants import flattened
from torchbeam.engine.chain.constants import Constants
from torchbeam.engine.chain.local_functions import LocalFunctions
from torchbeam.engine.chain.local_problem import NODE
from torchbeam.engine.chain.node_kinds import kinds_of
from torchbeam.equations.midpoint import MidpointUnknowns

SUMS = ("force", "moment", "strain", "left_force", "left_moment", "left_strain")


class Chain:
    """Newton's method for a `MidpointProblem` without batch axes."""

    def __init__(self, problem):
        model, self.problem = problem.model, problem
        constants = Constants(model)
        trees = constants.at(problem.dt, problem.t, problem.inputs)
        self.local, w = LocalFunctions(model, *trees), model.space.unknowns
        self.order, self.N, nodes = (
            self.local.order,
            model.scene.beam.element_count,
            model.node_count,
        )
        of_nodes, of_elements, common, *_ = map(flattened, trees)
        self.common = {f"common.{k}": x for k, (x, _) in enumerate(common)}
        self.node = [
            {f"node.{k}": rows(x, axes, j)[0] for k, (x, axes) in enumerate(of_nodes)}
            | self.common
            | {name: getattr(problem.start, name)[j] for name in NODE}
            for j in range(nodes)
        ]
        self.element = [
            {
                f"element.{k}": rows(x, axes, e, n)
                for k, ((x, axes), n) in enumerate(
                    zip(of_elements, self.local.element_rows, strict=True)
                )
            }
            | self.common
            for e in range(self.N)
        ]
        self.kinds = kinds_of(model, constants.acts)
        self.free, self.zero = (
            model.constraints.moving.to(model.length),
            {"vector": torch.zeros(w), "block": torch.zeros(w, w)},
        )
        self.unknown = [
            self.local.predictor(kind, **node)
            for kind, node in zip(self.kinds.nodes, self.node, strict=True)
        ]
        self.stress = list(problem.start.stress.split(self.order))

    def ends(self, e):
        """Fields of an element."""
        found = dict(self.element[e])
        for j, side in enumerate(self.local.sides, self.order * e):
            found |= {
                f"{side}.{name}": x
                for name, x in (self.node[j] | self.unknown[j]).items()
                if name not in self.common
            }
        return found | {"stress": self.stress[e]}

    def iterate(self):
        """One iteration: (scaled residual before it, reactions)."""
        N, local, model = self.N, self.local, self.problem.model
        vector, block = self.zero["vector"], self.zero["block"]
        nothing = {"balance": vector, "asked": vector, "D": block, "inertia": vector}
        sums, lines, elements = dict.fromkeys(SUMS, torch.zeros(())), [], []
        left = {**nothing, "L": block}
        own = [
            local.node(kind, **node, **x)
            for kind, node, x in zip(self.kinds.nodes, self.node, self.unknown, strict=True)
        ]
        middles, ahead, y, order = [], block, vector, self.order
        for j in range(N + 1):
            at, between, found = order * j, {}, []
            given = {f"own.{name}": x for name, x in own[at].items()}
            right = {**nothing, "U": block}
            if j < N:
                elements.append(between := local.element(self.kinds.elements[j], **self.ends(j)))
                found.append(between)
                if order == 2:
                    given_middle = {f"own.{name}": x for name, x in own[at + 1].items()}
                    given_middle |= {f"element.{name}": x for name, x in between.items()}
                    held = bool((self.free[at + 1] == 0).any())
                    between = local.condense(held, free=self.free[at + 1], **given_middle)
                    middles.append(between)
                    found.append(between)
                right = {name[2:]: x for name, x in between.items() if name[:2] == "i."} | {
                    "U": between["U"]
                }
            given |= {f"left.{name}": x for name, x in left.items()} | {
                f"right.{name}": x for name, x in right.items()
            }
            near = (
                self.free[max(at - order, 0)],
                self.free[at],
                self.free[min(at + order, order * N)],
            )
            held = any(bool((x == 0).any()) for x in near)
            if held:
                given |= dict(zip(("free_before", "free_here", "free_after"), near, strict=True))
            lines.append(local.row(held, ahead=ahead, y=y, **given))
            ahead, y = lines[j]["ahead"], lines[j]["y"]
            for one in (lines[j], *found):
                sums = {name: torch.maximum(x, one.get(name, x)) for name, x in sums.items()}
            if j < N:
                left = {name[2:]: x for name, x in between.items() if name[:2] == "j."} | {
                    "L": between["L"]
                }
        moves = [vector] * (order * N + 1 + 2 * order)  # those of node j stand in the row j + order
        for j in reversed(range(N + 1)):
            at = order * (j + 1)
            moves[at] = local.back(lines[j]["ahead"], lines[j]["y"], moves[at + order])["move"]
        for e, one in enumerate(middles):
            at = order * (e + 1)
            back = (one[name] for name in ("own", "by_i", "by_j"))
            moves[at + 1] = local.restore(*back, moves[at], moves[at + 2])["move"]
        reactions = []
        for at in model.constraints.nodes:
            k, inner = divmod(at, order)
            row, reach = (middles[k], 1) if inner else (lines[k], order)
            near = moves[at + order - reach], moves[at + order], moves[at + order + reach]
            reactions.append(
                local.reaction(row["rows"], row["asked"], self.free[at], *near)["reaction"]
            )
        self.stress = [
            local.stress(
                stress,
                found["gap"],
                found["E"],
                **self.element[e],
                **{f"{side}.move": moves[k] for k, side in enumerate(local.sides, order * (e + 1))},
            )["stress"]
            for e, (stress, found) in enumerate(zip(self.stress, elements, strict=True))
        ]
        self.unknown = [
            local.update(kind, moves[j + order], **self.node[j], **self.unknown[j])
            for j, kind in enumerate(self.kinds.nodes)
        ]
        zero, one = torch.zeros(()), torch.ones(())
        size = local.judge(
            **sums,
            total=model.length.sum(),
            longest=model.length.amax(),
            exact=one,
            tolerance=one,
            before=zero,
            over=zero,
            done=zero,
            status=zero,
            iterations=zero,
        )["before"]
        return size, torch.stack(reactions) if reactions else vector.new_zeros(0, len(vector))

    @property
    def x(self):
        return MidpointUnknowns(
            *(torch.stack([x[name] for x in self.unknown]) for name in "um"), torch.cat(self.stress)
        )

    def finish(self):
        """Fields of the nodes at the end, and the work done."""
        found = [
            self.local.finish(kind, **node, **x)
            for kind, node, x in zip(self.kinds.nodes, self.node, self.unknown, strict=True)
        ]
        return {name: torch.stack([x[name] for x in found]) for name in NODE} | {
            "work": sum(x["work"] for x in found)
        }


def rows(x, axes, k, count=1):
    """Of node k, or of element k, which has so many; what all share has one row."""
    at = x.ndim - axes
    if x.shape[at] == 1:
        return x.expand(*x.shape[:at], count, *x.shape[at + 1 :])
    return x.narrow(at, count * k, count)
