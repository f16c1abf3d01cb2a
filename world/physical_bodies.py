"""Physical bodies, integrated by MuJoCo (Todorov et al. 2012): differential drives with mass, wheels that slip, and contact.

A robot is a disc on two driven wheels and a caster. The sensor stands on a turret in the middle of the disc; the axle lies behind it.
The middle can move in any direction (`world.unicycle`), and the turret turns at the commanded rate whatever the disc does. A body
without a command brakes and stays where it is: an obstacle to the others, which can be pushed.

The same commands give the same poses to the last bit on one machine: MuJoCo runs in one thread and draws no random numbers.
"""

import math
from typing import Any

import numpy as np

from protocol.arithmetic import elementwise
from protocol.geometry import wrap_angle
from protocol.messages import Command
from protocol.pose import clip_motion
from protocol.sensing import Pose
from protocol.settings import BadSetting, LimitSettings
from world.unicycle import twist

STEP = 0.005  # s, of the integrator
INNER = 4  # steps between two commands to the wheels: 20 ms
LEAST_RADIUS, DENSITY = 0.05, 600.0  # m; kg/m^3 of the disc
AXLE, TRACK, WHEEL, HEIGHT = 0.55, 0.5, 0.3, 0.5  # in radii: axle to middle, half of the axle, wheel, height of the disc
RESPONSE = 0.03  # s, time constant of the motors while the wheels grip
FRICTION = 1.0  # of wheels on the floor, which has none of its own: MuJoCo takes the larger of two, and casters have none
GRAVITY = 9.81  # m/s^2

MODEL = """
<mujoco>
  <option timestep="{step}" integrator="implicitfast" gravity="0 0 -{gravity}"/>
  <default>
    <default class="floor"><geom contype="0" conaffinity="1" condim="1" friction="0 0 0"/></default>
    <default class="disc"><geom contype="2" conaffinity="2" condim="3" friction="0.3 0 0"/></default>
    <default class="wheel"><geom contype="1" conaffinity="0" condim="3" friction="{friction} 0 0"/></default>
    <default class="caster"><geom contype="1" conaffinity="0" condim="1"/></default>
    <default class="load"><geom contype="0" conaffinity="0"/></default>
  </default>
  <worldbody><geom class="floor" type="plane" size="0 0 1"/>{robots}</worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""
ROBOT = """
<body name="{name}" pos="{x} {y} {wheel}" euler="0 0 {degrees}"><freejoint/>
  <geom name="{name}" class="disc" type="cylinder" size="{radius} {half}" mass="{disc}"/>
  <geom class="load" type="box" size="{half} {half} {half}" pos="-{behind} 0 -{half}" mass="{battery}"/>
  <geom class="caster" type="sphere" size="{caster}" pos="{front} 0 -{low}" mass="0"/>
  <geom class="caster" type="sphere" size="{caster}" pos="-{front} 0 -{low}" mass="0"/>
  <body pos="-{axle} {track} 0"><joint name="{name}.left" axis="0 1 0" armature="{rotor}"/>
    <geom class="wheel" size="{wheel}" mass="{small}"/></body>
  <body pos="-{axle} -{track} 0"><joint name="{name}.right" axis="0 1 0" armature="{rotor}"/>
    <geom class="wheel" size="{wheel}" mass="{small}"/></body>
  <body pos="0 0 {half}"><joint name="{name}.turret" axis="0 0 1"/>
    <geom class="load" type="cylinder" size="{wheel} {caster}" mass="{small}"/></body>
</body>
"""
MOTOR = """<velocity joint="{joint}" kv="{gain}" forcerange="-{force} {force}"/>"""


def load_mujoco() -> Any:
    """The package; raises BadSetting where it is not installed."""
    try:
        import mujoco
    except ImportError as error:
        elsewhere = "python -m pip install 'mujoco>=3.3,<4', or the wheel file with its extra [mujoco]"
        how = f"in a checkout COVEY_EXTRAS=mujoco ./covey version; elsewhere {elsewhere}"
        raise BadSetting(f"bodies.model = 'mujoco': needs the package mujoco ({error}): {how}") from None
    return mujoco


def check_physics(limits: LimitSettings) -> None:
    """Raise BadSetting for bodies that have no size."""
    if limits.radius < LEAST_RADIUS:
        raise BadSetting(f"limits.radius = {limits.radius:g}: should be at least {LEAST_RADIUS:g} m with bodies.model = 'mujoco'")


class PhysicalBodies:
    """The poses of all bodies by name, in team order: the middle of each disc, and the heading of its turret."""

    def __init__(self, dt: float, limits: LimitSettings) -> None:
        check_physics(limits)
        self.poses: dict[str, Pose] = {}
        self.touches = 0  # steps in which two discs touched
        self._mujoco, self._limits = load_mujoco(), limits
        self._rounds = max(1, math.ceil(dt / (STEP * INNER) - 1.0e-9))  # of commands to the wheels, in a tick
        self._step = dt / (self._rounds * INNER)
        self._model: Any = None
        self._data: Any = None
        self._names: list[str] = []  # of the bodies in the model
        self._discs = np.empty(0, dtype=bool)  # by geom

    def place(self, name: str, pose: Pose) -> None:
        """Put a body somewhere, standing; a new one goes to the end of the order."""
        self.poses[name] = pose
        if name in self._names:
            self._build()

    def move(self, commands: dict[str, Command]) -> None:
        """Integrate one tick; bodies without a command brake."""
        if list(self.poses) != self._names:
            self._build()
        for _ in range(self._rounds):
            self._steer(commands)
            for _ in range(INNER):
                self._mujoco.mj_step(self._model, self._data)
                self.touches += self._in_touch()
        state = self._data.qpos.reshape(-1, QPOS)
        headings = _yaws(state) + state[:, 9]
        self.poses = {
            name: (float(x), float(y), wrap_angle(float(turn))) for name, (x, y), turn in zip(self._names, state[:, :2], headings)
        }

    def _steer(self, commands: dict[str, Command]) -> None:
        """Set the speeds of wheels and turrets: forward speed and turn rate follow the command, the turret makes up for the turn."""
        limits, radius = self._limits, self._limits.radius
        yaws, turns = _yaws(self._data.qpos.reshape(-1, QPOS)), self._data.qvel.reshape(-1, QVEL)[:, 5]
        speeds = self._data.ctrl.reshape(-1, 3)
        for row, name in enumerate(self._names):
            forward = turn = pan = 0.0
            command = commands.get(name)
            if command is not None:
                velocity, pan = clip_motion(command.velocity, command.turn_rate, limits)
                forward, turn = twist(float(yaws[row]), velocity, AXLE * radius, limits)
            left, right = forward - turn * TRACK * radius, forward + turn * TRACK * radius
            speeds[row] = left / (WHEEL * radius), right / (WHEEL * radius), pan - turns[row]

    def _in_touch(self) -> bool:
        """Whether two discs touch."""
        pairs = self._data.contact.geom
        return bool((self._discs[pairs[:, 0]] & self._discs[pairs[:, 1]]).any())

    def _build(self) -> None:
        """Make the model anew of all bodies at their poses; those that were in it keep turning and moving."""
        before = {name: row.copy() for name, row in zip(self._names, self._data.qpos.reshape(-1, QPOS))} if self._names else {}
        moving = {name: row.copy() for name, row in zip(self._names, self._data.qvel.reshape(-1, QVEL))} if self._names else {}
        self._names = list(self.poses)
        self._model = self._mujoco.MjModel.from_xml_string(model_text(self.poses, self._step, self._limits.radius))
        self._data = self._mujoco.MjData(self._model)
        for row, name in enumerate(self._names):
            kept = before.get(name)
            if kept is not None and (kept[0], kept[1]) == self.poses[name][:2]:
                self._data.qpos[QPOS * row : QPOS * (row + 1)] = kept
                self._data.qvel[QVEL * row : QVEL * (row + 1)] = moving[name]
        self._mujoco.mj_forward(self._model, self._data)
        self._discs = np.array([self._model.geom_contype[geom] == 2 for geom in range(self._model.ngeom)])


QPOS, QVEL = 10, 9  # numbers of a robot: x, y, z, quaternion, left, right, turret; and their velocities


def _yaws(state: np.ndarray) -> np.ndarray:
    """The headings of the discs in rad, from the rows of qpos (N, 10)."""
    w, x, y, z = state[:, 3:7].T
    return elementwise(math.atan2, 2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def model_text(poses: dict[str, Pose], step: float, radius: float) -> str:
    """The MJCF model of robots at these poses, the turrets facing ahead. Two thirds of the mass is a battery between the wheels."""
    robots, motors = [], []
    mass, wheel = DENSITY * math.pi * radius**2 * HEIGHT * radius, WHEEL * radius  # kg, m
    small = 0.02 * mass
    sizes = {"radius": radius, "half": 0.4 * HEIGHT * radius, "wheel": wheel, "axle": AXLE * radius, "track": TRACK * radius}
    sizes |= {"front": 0.85 * radius, "behind": 0.35 * radius, "caster": 0.1 * radius, "low": wheel - 0.11 * radius}
    masses = {"disc": 0.3 * mass, "battery": 0.64 * mass, "small": small, "rotor": 0.1 * mass * wheel * wheel}
    drive = MOTOR.format(joint="{joint}", gain=repr(mass * wheel * wheel / RESPONSE), force=repr(0.4 * FRICTION * mass * GRAVITY * wheel))
    inertia = 0.5 * small * wheel * wheel
    pan = MOTOR.format(joint="{joint}", gain=repr(inertia / RESPONSE), force=repr(1000.0 * inertia))
    for number, (x, y, heading) in enumerate(poses.values()):
        name = f"b{number}"
        robots.append(ROBOT.format(name=name, x=repr(x), y=repr(y), degrees=repr(math.degrees(heading)), **sizes, **masses))
        motors += [drive.format(joint=f"{name}.{side}") for side in ("left", "right")] + [pan.format(joint=f"{name}.turret")]
    return MODEL.format(step=repr(step), gravity=GRAVITY, friction=FRICTION, robots="".join(robots), motors="".join(motors))
