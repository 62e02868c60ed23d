"""The arm of `TrackTarget-v0` under the same actions, beside what other programs' scripts printed:

    python examples/peers/soft_arm/pyelastica_arm.py > arm.jsonl     # where PyElastica is installed
    python examples/peers/soft_arm/mujoco_arm.py >> arm.jsonl        # where MuJoCo is
    python examples/peers/soft_arm/torchbeam_arm.py arm.jsonl

A row a program and kind of actions: how far the tips are apart, as a share of the tip's motion
(RMS, and at most), and control intervals a CPU second of both, here alone and in batches.
"""

import json
import sys
import time
from itertools import product
from pathlib import Path

import numpy as np
import torch
import torchbeam_envs as envs
from case import HELD, INTERVALS, actions

BATCHES = 1, 16, 256


def run(arms):
    """Tips (interval, arms, 3) m under actions (interval, arms, 12), and CPU seconds."""
    env = envs.TrackTargetVectorEnv(arms.shape[1])
    env.reset(seed=0)
    env.step(arms[0])  # compiles
    env.reset(seed=0)
    tips, start = [], time.process_time()
    for each in arms:
        env.step(each)
        tips.append(env.episodes.beam.position[:, -1].numpy().copy())
    return np.array(tips), time.process_time() - start


def compared(rows):
    """Prints a line of JSON a program and kind."""
    rest = np.array([0.0, 1.0, 0.0])
    for peer, kind in product(dict.fromkeys(row["peer"] for row in rows), HELD):
        peers = [row for row in rows if (row["peer"], row["actions"]) == (peer, kind)]
        theirs = np.array([row["tip"] for row in peers]).swapaxes(0, 1)
        ours, _ = run(np.stack([actions(kind, row["seed"]) for row in peers], 1))
        apart, moved = (np.linalg.norm(x, axis=-1) for x in (ours - theirs, theirs - rest))
        scale = np.sqrt((moved**2).mean())
        found = {"actions": kind, "runs": len(peers), "motion_rms_m": scale}
        found |= {"rms": np.sqrt((apart**2).mean()) / scale, "most": apart.max() / scale}
        found["peer"] = peer
        found["peer_intervals_a_cpu_s"] = INTERVALS / min(row["cpu_s"] for row in peers)
        print(json.dumps(found), flush=True)


def rates():
    for batch in BATCHES:
        arms = np.stack([actions("held for 0.14 s", seed) for seed in range(batch)], 1)[:300]
        _, seconds = run(arms)
        print(json.dumps({"batch": batch, "intervals_a_cpu_s": batch * len(arms) / seconds}))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("a file is wanted, of what the other programs' scripts printed")
    torch.set_num_threads(1)
    with torch.no_grad():
        compared([json.loads(line) for line in Path(sys.argv[1]).read_text().splitlines()])
        rates()
