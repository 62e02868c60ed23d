"""Tasks, and each learner's settings for them. What is not named here is the default of the
learner's `Arguments`.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass, field, replace
from typing import Any

import gymnasium
from gymnasium.vector import VectorEnv
from torchbeam_envs import UNCERTAIN

from .ways import RESOLVED, WAYS

# first seeds of episodes, far apart: those learned on, those that choose among policies, and those
# of final scores, which nothing sees before, the last on plants from `WIDER` ranges
TRAINING, VALIDATION, HELD_OUT, OUTSIDE = 1_000_000, 1_500_000, 2_000_000, 3_000_000
# observations side by side that learners without a memory see of a plant that is not known, and
# SHAC of one that is not stable either; PPO and SAC do worse there with as many
FRAMES, FRAMES_UNSTABLE = 4, 12


@dataclass(frozen=True)
class Task:
    """An environment with its arguments, and what success is in it.

    error      the entry of `info` that is to become small (m)
    tolerance  (m) an episode is a success if the error stays within it over the last `hold` steps,
               and it did not end early
    """

    name: str
    env: str
    arguments: dict[str, Any] = field(default_factory=dict)
    error: str = "distance"
    tolerance: float = 0.03
    hold: int = 10

    def make(self, num_envs: int, **arguments: Any) -> VectorEnv:
        """The vector env; SAME_STEP autoreset unless the arguments say otherwise."""
        return gymnasium.make_vec(
            self.env,
            num_envs,
            **{
                "autoreset_mode": "SameStep",
                "params_in_info": False,
                **self.arguments,
                **arguments,
            },
        )

    def varied(self, **arguments: Any) -> Task:
        """The task with other arguments of the environment."""
        return replace(self, arguments={**self.arguments, **arguments})

    def seen(self, frames: int) -> Task:
        """The task as a learner sees it that looks at so many frames at once; 0: as it is."""
        return self.varied(frames=frames) if frames else self


def task_named(name: str) -> Task:
    """One of `TASKS`, or MODULE:NAME, a `Task` of one's own, also in this folder.

    Raises ValueError where there is none.
    """
    if name in TASKS:
        return TASKS[name]
    module, colon, attribute = name.partition(":")
    if not colon:
        raise ValueError(
            f"the task {name!r} was given; one of {', '.join(TASKS)} is wanted, or MODULE:NAME, a "
            "training.tuned.Task"
        )
    try:
        task = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"the task {name!r} was given, which cannot be had: {error}") from None
    if not isinstance(task, Task):
        raise ValueError(
            f"the task {name!r} was given, which is a {type(task).__name__}; a "
            "training.tuned.Task is wanted"
        )
    return task


# of FlutterHold. Its own, minus what each interval left would cost at most (up to 500), is more
# than PPO learns from: uncertain, five of five runs of 200,000 steps, of four settings, ended where
# no action does; SHAC learns as much by either
LOST: dict[str, Any] = dict(failure_reward=-100.0)

TASKS = {
    task.name: task
    for task in (
        Task("reach", "torchbeam/TipReachPlanar-v1", dict(elements=4, substeps=1)),
        Task("track", "torchbeam/TipTrackPlanar-v1", dict(elements=4, substeps=1), hold=50),
        Task(
            "flutter",
            "torchbeam/FlutterHoldPlanar-v1",
            dict(elements=6, substeps=2, **LOST),
            tolerance=0.01,
        ),
        Task(
            "slew", "torchbeam/SlewPlanar-v1", dict(elements=4, substeps=1), hold=25
        ),  # half a period of the strip
        Task(
            "payload",
            "torchbeam/PayloadPlanar-v2",
            dict(elements=4, substeps=1),  # its mass is unknown at either level
            tolerance=0.01,
            hold=25,
        ),
        Task("reach-3d", "torchbeam/TipReach-v1", dict(elements=4, substeps=1)),
        Task("track-3d", "torchbeam/TipTrack-v1", dict(elements=4, substeps=1), hold=50),
        Task(
            "flutter-3d",
            "torchbeam/FlutterHold-v1",
            dict(elements=6, substeps=2, **LOST),
            tolerance=0.01,
        ),
    )
}


def _uncertain(task: Task) -> Task:
    """The task at its uncertain level."""
    env = task.env.partition("/")[2].partition("-")[0].removesuffix("Planar")
    return replace(task.varied(**UNCERTAIN[env]), name=f"{task.name}-uncertain")


TASKS |= {task.name: task for task in map(_uncertain, [*TASKS.values()])}
# of which the plant is not known
HIDDEN = ("payload", *(name for name in TASKS if name.endswith("-uncertain")))


def frames(task: str) -> int:
    """Observations side by side that a learner without a memory sees; 0: as the task has them."""
    return FRAMES if task in HIDDEN else 0


# ranges half as wide again as those of UNCERTAIN (damping: its factor), upwards where they begin
# with none; all are drawn evenly
WIDER = {
    "stiffness": (0.55, 1.45),
    "damping": (1e-3 / 4.5, 4.5e-3),
    "clamp": (0.001, 0.075),
    "tip_mass": (0.0, 0.036),
    "payload": (0.025, 0.175),
    "latency": (0.0, 3.0),
    "lag": (0.0, 0.03),
    "gain": (0.85, 1.15),
    "bias": (0.0, 0.015),
}


def widened(task: Task) -> Task | None:
    """The task with plants from `WIDER` ranges; None where it draws from no range that these go
    beyond.
    """
    drawn = task.arguments.get("randomize")
    if not isinstance(drawn, dict):
        return None
    wider = {
        name: WIDER[name]
        for name, (low, high) in drawn.items()
        if name in WIDER and (WIDER[name][0] < low or high < WIDER[name][1])
    }
    return task.varied(randomize={**drawn, **wider}) if wider else None


# what it does not know is random at its own level
GRIP: dict[str, Any] = dict(tolerance=0.005, hold=25)
TASKS["grip"] = Task("grip", "torchbeam/GripperPlanar-v1", **GRIP)
TASKS["grip-3d"] = Task("grip-3d", "torchbeam/Gripper-v1", **GRIP)
TASKS["peg"] = Task(  # parts of a step that fails are made by torch operations: rather iterations
    "peg",
    "torchbeam/PegPlanar-v1",
    dict(substeps=8, solver={"halvings": 5, "iterations": 60}),
    tolerance=0.005,
    hold=25,
)

# published tasks, in their own numbers: returns can be laid beside each other
FOLLOW: dict[str, Any] = dict(tolerance=0.1)
TASKS["follow"] = Task("follow", "torchbeam/FollowTargetPlanar-v1", **FOLLOW)
TASKS["follow-3d"] = Task("follow-3d", "torchbeam/FollowTarget-v1", **FOLLOW)
TASKS["ik"] = Task("ik", "torchbeam/InverseKinematics-v1", tolerance=0.05)
OBSTACLES: dict[str, Any] = dict(tolerance=0.05)
TASKS["obstacles"] = Task("obstacles", "torchbeam/ReachObstaclesPlanar-v0", **OBSTACLES)
TASKS["obstacles-3d"] = Task("obstacles-3d", "torchbeam/ReachObstacles-v0", **OBSTACLES)
# of the other publication, in its own numbers too: 7,142, 1,428 and 3,571 intervals an episode
ARM: dict[str, Any] = dict(tolerance=0.05, hold=100)
TASKS["track-target"] = Task("track-target", "torchbeam/TrackTarget-v0", **ARM)
TASKS["reach-pose"] = Task("reach-pose", "torchbeam/ReachPose-v0", **ARM)
TASKS["reach-behind"] = Task("reach-behind", "torchbeam/ReachBehind-v0", **ARM)
TASKS["reach-nest"] = Task("reach-nest", "torchbeam/ReachBehindNest-v0", **ARM)
# episodes that tell enough of them: of one in which nothing is random
FEW = {"obstacles": 1, "track-target": 16, "reach-pose": 16, "reach-behind": 1, "reach-nest": 1}
PUBLISHED = ("follow", "follow-3d", "ik", "obstacles", "obstacles-3d")
PUBLISHED += ("track-target", "reach-pose", "reach-behind", "reach-nest")

# what the results table is made for unless tasks are named
NOMINAL = ("reach", "track", "flutter", "slew", "payload")
DEFAULT = (*NOMINAL, *(f"{name}-uncertain" for name in NOMINAL))

# environment steps of a run by algorithm: 10 to 40 CPU seconds of an idle core, up to 110 and of
# SHAC 120 to 250 with a memory
BUDGETS = {
    "ppo": 500_000,
    "sac": 30_000,
    "shac": 300_000,
    "student": 40_000,
    "ppo-gru": 500_000,
    "sac-gru": 30_000,
    "shac-gru": 1_200_000,
    "sb3-ppo": 200_000,
    "sb3-sac": 20_000,
    "skrl-ppo": 300_000,
}
# by (algorithm, task), where a task wants others: up to 140 seconds, with a memory 230
TASK_BUDGETS: dict[tuple[str, str], int] = {
    # learned to the end of as many
    ("shac", "reach"): 750_000,
    ("shac", "track"): 1_500_000,
    ("shac", "slew"): 600_000,
    ("shac", "flutter-uncertain"): 360_000,
    ("shac", "reach-3d"): 900_000,
    ("shac", "track-3d"): 450_000,
    ("ppo", "track"): 2_000_000,
    ("ppo", "reach"): 800_000,  # its updates are larger, and as many
    ("ppo", "slew-uncertain"): 800_000,  # learned slowly, to the end of as many
    ("ppo", "reach-3d"): 400_000,
    ("ppo", "track-3d"): 250_000,
    ("shac", "follow"): 600_000,
    ("shac", "follow-3d"): 600_000,
    ("sac", "follow-3d"): 5_000_000,  # as published
    ("student", "ik"): 400_000,
    ("student", "track-target"): 10 * 256 * 204,
    ("student", "reach-pose"): 16 * 256 * 72,
    ("student", "reach-behind"): 4 * 8 * 510,
    ("student", "reach-nest"): 8 * 8 * 510,
    ("shac-gru", "track-uncertain"): 2_400_000,
    ("shac-gru", "track-3d-uncertain"): 2_400_000,
    ("shac", "obstacles"): 2_400,  # as dear as thirty times as many of the others
}


def budget(algorithm: str, task: str) -> int:
    """Environment steps of a run."""
    return TASK_BUDGETS.get((algorithm, task), BUDGETS[algorithm])


# taught first: what a network does without, touches no ball
GRASPING: dict[str, Any] = dict(teacher="Grasp", lessons=4, num_envs=32, deviation=0.1)
# taught first, by controllers that read the true state, in lessons alone; settings of LQR are those
# of the results table
TAUGHT: dict[str, dict[str, Any]] = {
    "reach": dict(teacher="LQR(effort=0.1, speed_weight=3.0, schedule=5)", linear=True),
    "flutter": dict(teacher="LQR(effort=0.003, speed_weight=0.01, schedule=3)", linear=True),
    "slew": dict(teacher="JointLQR(effort=1.0, speed_weight=0.01)", linear=True),
    "track": dict(teacher="MPC", linear=True),
    "track-3d": dict(  # eight lessons of MPC would take as long as the whole run
        teacher="LQR(effort=0.001, speed_weight=0.01, schedule=3)", linear=True
    ),
    "flutter-uncertain": dict(teacher="MPC(informed=True)", linear=True),
}


def _called(name: str, settings: dict[str, Any]) -> str:
    """A teacher by its settings."""
    return f"{name}({', '.join(f'{key}={value}' for key, value in settings.items())})"


def _led(task: str, **settings: Any) -> str:
    """As a teacher: by the Jacobian of the arm as it stands."""
    return _called("ResolvedRate", {**RESOLVED[task], **settings})


# without a teacher SHAC takes 12 CPU seconds to a return above 0
FOLLOWING: dict[str, Any] = dict(teacher=_led("follow"), linear=True, discount=0.95)
# the published reward has bonuses by steps, through which no gradient goes
SMOOTH: dict[str, Any] = dict(num_envs=64, deviation=0.1, reward_scale=0.3, smooth=0.03)
# chosen by validation episodes of one to three runs of 12 to 150 CPU seconds
PPO: dict[str, dict[str, Any]] = {
    "reach": dict(
        **TAUGHT["reach"], lessons=3, num_envs=128, horizon=25, gain=1.4, deviation=0.1
    ),  # more data an update, or what was taught is lost
    "flutter": dict(**TAUGHT["flutter"], lessons=5, rate=1e-4, deviation=0.05),
    "slew": dict(  # by less data an update or more noise, too, what was taught is lost
        **TAUGHT["slew"],
        lessons=5,
        num_envs=256,
        horizon=50,
        epochs=16,
        trace=0.99,
        rate=5e-4,
        deviation=0.03,
    ),
    "slew-uncertain": dict(num_envs=32, horizon=50, rate=2e-3),
    "grip": dict(**GRASPING, horizon=25, rate=5e-4),
    "follow": dict(**FOLLOWING, lessons=12, deviation=0.2),
}
SAC: dict[str, dict[str, Any]] = {"follow": dict(discount=0.95, num_envs=64, horizon=4)}
# rewards that become small are scaled up: else the critic's errors hide them
SHAC: dict[str, dict[str, Any]] = {
    "reach": dict(**TAUGHT["reach"], lessons=4, rate=5e-3, deviation=0.1),
    "track": dict(**TAUGHT["track"], lessons=8, rate=3e-3, reward_scale=1.0, deviation=0.03),
    "track-3d": dict(**TAUGHT["track-3d"], lessons=8, rate=3e-3, reward_scale=1.0, deviation=0.03),
    "flutter": dict(**TAUGHT["flutter"], lessons=4, rate=2e-3, reward_scale=10.0, deviation=0.05),
    "flutter-uncertain": dict(**TAUGHT["flutter-uncertain"], lessons=60, rate=2e-3, deviation=0.03),
    "slew": dict(**TAUGHT["slew"], lessons=4, rate=3e-3, deviation=0.1),
    "payload": dict(critics=2),  # by one, two of ten seeds ended badly
    "flutter-3d": dict(rate=5e-3, reward_scale=10.0, deviation=0.1),
    "grip": dict(**GRASPING, horizon=25, rate=2e-3),
    "grip-3d": dict(**GRASPING, horizon=25, rate=2e-3),
    "peg": dict(teacher="Insert", lessons=8, num_envs=32, deviation=0.1, rate=2e-3),
    "follow": dict(**FOLLOWING, **SMOOTH, lessons=12, horizon=32, rate=3e-3, hidden=(128, 128)),
    "follow-3d": dict(**FOLLOWING, **SMOOTH, lessons=24, horizon=16, rate=2e-3, hidden=(128, 128)),
    # the way is narrow: at a rate of 5e-4 and a deviation of 0.03 what was taught was lost
    "obstacles": {
        **FOLLOWING,
        **SMOOTH,
        **dict(teacher=_called("Waypoints", WAYS["obstacles"]), lessons=4, horizon=25),
        **dict(num_envs=16, rate=1e-4, deviation=0.01, discount=0.98),
    },
    "obstacles-3d": dict(**FOLLOWING, **SMOOTH, lessons=12, horizon=12, rate=2e-3),
}
SHAC["flutter-uncertain"]["frames"] = FRAMES_UNSTABLE
SHAC["flutter-3d-uncertain"] = dict(frames=FRAMES_UNSTABLE)
# in space as in the plane
PPO |= {"reach-3d": PPO["reach"], "follow-3d": PPO["follow"]}
# as many environments, updates and transitions in one as published (Choi and Tong 2025)
SAC["follow-3d"] = dict(
    **dict(discount=0.95, num_envs=500, horizon=1, updates=4, minibatch=1024, target=0.005),
    **dict(hidden=(128, 128), replay=500_000, warmup=10_000),
)
SHAC["reach-3d"] = SHAC["reach"]
# in as many steps as budgets have, whatever the budget of a run is, rates of SHAC fall to a tenth
for (_algorithm, _task), _steps in TASK_BUDGETS.items():
    if _algorithm == "shac":
        SHAC[_task] = {"falling": _steps, **SHAC.get(_task, {})}
for _task in HIDDEN:
    for _settings in (PPO, SAC, SHAC):
        _settings[_task] = {"frames": FRAMES, **_settings.get(_task, {})}
# with a memory, which sees one frame
REMEMBERING = ("student", "ppo-gru", "sac-gru", "shac-gru")
MEMORY: dict[str, Any] = dict(memory=64, frames=0)
# of intervals of 1.4 ms, of which every fifth tells as much; arms are held by smooth couples, which
# can be told from what is seen
LONG: dict[str, Any] = dict(
    memory=0, hidden=(128, 128), num_envs=256, pace=5, horizon=72, lessons=6, updates=800
)
LONGER: dict[str, Any] = {**LONG, "horizon": 204, "lessons": 4, "updates": 1600}
# of one episode, in which nothing is random
ALONE: dict[str, Any] = dict(
    memory=0, hidden=(128, 128), num_envs=8, horizon=510, lessons=7, updates=400
)
STUDENT: dict[str, dict[str, Any]] = {
    "ik": dict(teacher=_led("ik"), memory=0, hidden=(128, 128), lessons=50, horizon=20, updates=80),
    "track-target": dict(teacher=_led("track-target", standing=0.01), **LONGER),
    "reach-pose": dict(teacher=_led("reach-pose", standing=0.01), **LONG),
    "reach-behind": dict(teacher=_called("Waypoints", WAYS["reach-behind"]), **ALONE),
    # the nest's way is narrow: in half of its lessons the student plays alone
    "reach-nest": dict(
        {**ALONE, "updates": 800, "lessons": 4}, teacher=_called("Waypoints", WAYS["reach-nest"])
    ),
}
PPO_GRU = {_task: {**PPO[_task], **MEMORY} for _task in HIDDEN}
# transitions one after the other tell less than as many from anywhere
SAC_GRU = {_task: {**SAC[_task], **MEMORY, "minibatch": 512} for _task in HIDDEN}
SHAC_GRU: dict[str, dict[str, Any]] = {  # as a student first, then by the gradient
    _task: dict(
        **dict(teacher="MPC(informed=True)", lessons=25, linear=True, num_envs=64, horizon=25),
        **dict(rate=1e-3, deviation=0.05, falling=BUDGETS["shac-gru"], discount=0.998, average=50),
        **MEMORY,
    )
    for _task in HIDDEN
}
# by windows of half as many intervals it returns less; on track windows of as many lose what was
# taught: the gradient grows with them
SHAC_GRU["slew-uncertain"] |= dict(horizon=50)
# at twice the rate one of two seeds lost what was taught on track; on flutter one of two learned
# nothing by the discount of the others
SHAC_GRU["flutter-uncertain"] |= dict(rate=2e-3, discount=0.99)
for _task in ("track-uncertain", "track-3d-uncertain"):
    SHAC_GRU[_task] |= dict(falling=budget("shac-gru", _task))
# of libraries, over their own, on all tasks
SB3: dict[str, dict[str, Any]] = {
    "ppo": dict(
        num_envs=64,
        n_steps=32,
        batch_size=512,
        n_epochs=8,
        learning_rate=1e-3,
        policy_kwargs={"log_std_init": -0.7},
    ),
    "sac": dict(
        num_envs=32,
        learning_rate=1e-3,
        gradient_steps=8,
        learning_starts=1600,
        buffer_size=500_000,
        batch_size=256,
        policy_kwargs={"net_arch": [64, 64]},
    ),
}
SKRL: dict[str, Any] = dict(
    num_envs=64,
    rollouts=32,
    mini_batches=4,
    learning_rate=1e-3,
    time_limit_bootstrap=True,
    hidden=64,
    log_deviation=-0.7,
)
