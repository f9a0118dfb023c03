"""Real time on a clock that the tests turn: who does what at which nanosecond."""

import heapq
import itertools
import math
from functools import partial

import can
import numpy as np
from scipy.signal import cont2discrete

from can_rig.controllers.our_law import OurLaw
from can_rig.controllers.protocol import InNode
from can_rig.nodes.bus_access import StopRequest, Timeouts, Watchdog
from can_rig.nodes.realtime.controller_node import RealTimeControllerNode
from can_rig.nodes.realtime.plant_node import RealTimePlantNode
from can_rig.nodes.recording import LaterFile, Recorder
from can_rig.nodes.ticks import drive
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from firmware_model.design.vehicle import VehicleParameters, vehicle_state_space
from firmware_model.firmware import PYTHON_LAW

LSB = 1e-8  # of D* on the wire
TICK_NS = 1_000_000
PATIENT = Timeouts(math.inf, math.inf)
REFERENCE, FEEDBACK, TORQUE, FORCE, STATUS = (0x100, 0x101, 0x110, 0x111, 0x120)


class Slow(OurLaw):
    """The control law, which takes longer over some ticks of a world."""

    def __init__(self, world, scenario, network):
        super().__init__(scenario, network, PYTHON_LAW)
        self.world = world

    def step(self, inputs):
        if math.isfinite(inputs.measurement):
            self.world.controller_ns += self.world.held_up_ns.get(self.world.controller._tick, 0)
        return super().step(inputs)


class World:
    """A clock, a bus and a controller, all by hand: who does what at which nanosecond.

    ``answers(tick)`` is how many ns after the feedback of ``tick`` the controller gets to run, None
    for never; ``wakes(tick)`` how late the plant node wakes at a deadline.
    """

    def __init__(self, scenario, answers=lambda tick: 200_000, wakes=lambda tick: 0):
        self.scenario, self.network = scenario, network_of(scenario)
        self.ns = 5_000_000_000
        self.answers, self.wakes = answers, wakes
        self.controller_ns = 0
        self.to_plant, self.to_controller, self.runs = [], [], []
        self.order = itertools.count()
        self.sent = []  # (ns, message) of the plant node
        self.wake_ups = itertools.count(1)
        self.watchdog = None
        self.held_up_ns = {}
        self.start_controller()

    def slow(self, scenario, network):
        return Slow(self, scenario, network)

    def start_controller(self):
        self.to_controller.clear()
        self.controller = RealTimeControllerNode(
            self.scenario,
            self.network,
            self.Controller(self),
            self.Controller(self),
            InNode(self.slow),
        )
        self.watchdog = Watchdog(self.Controller(self), "plant", PATIENT, StopRequest())

    # the clock of the plant node

    def stamp_s(self):
        return self.ns * 1e-9

    def now_ns(self):
        return self.ns

    def sleep_until(self, at_ns):
        self.ns = max(self.ns, at_ns + self.wakes(next(self.wake_ups)))

    # the bus of the plant node

    def send(self, message):
        message = can.Message(
            timestamp=self.ns * 1e-9, arbitration_id=message.arbitration_id,
            is_extended_id=False, data=bytes(message.data),
        )  # fmt: skip
        self.sent.append((self.ns, message))
        self.to_controller.append((self.ns, message))
        if message.arbitration_id == FEEDBACK:
            delay_ns = self.answers(tick_of(message))
            if delay_ns is not None:
                heapq.heappush(self.runs, (self.ns + delay_ns, next(self.order)))

    def recv(self, timeout):
        end_ns = self.ns + round(timeout * 1e9)
        while self.runs and self.runs[0][0] <= end_ns:
            at_ns, number = heapq.heappop(self.runs)
            if at_ns < self.controller_ns:  # still at work
                heapq.heappush(self.runs, (self.controller_ns, number))
                continue
            self.controller_ns = at_ns
            if self.to_controller and self.to_controller[0][0] <= self.controller_ns:
                self.controller.serve(self.watchdog)
        if self.to_plant and self.to_plant[0][0] <= end_ns:
            at_ns, message = self.to_plant.pop(0)
            self.ns = max(self.ns, at_ns)
            return message
        self.ns = end_ns
        return None

    class Controller:
        """The bus and the clock as the controller has them."""

        def __init__(self, world):
            self.world = world

        def stamp_s(self):
            return self.world.controller_ns * 1e-9

        def send(self, message):
            self.world.to_plant.append((self.world.controller_ns, message))

        def recv(self, _timeout):
            queue = self.world.to_controller
            if queue and queue[0][0] <= self.world.controller_ns:
                return queue.pop(0)[1]
            return None

    def run(self, log=None, on_tick=lambda tick: None, waiting=PATIENT, stop=None):
        recorder = Recorder(log, LaterFile) if log else None
        plant = RealTimePlantNode(self.scenario, self.network, self, recorder, self)
        watchdog = Watchdog(self, "controller", waiting, stop or StopRequest())
        try:
            ticks = drive(partial(plant.carry, watchdog), plant.ticks, on_tick)
        finally:
            if recorder is not None:
                recorder.__exit__(None, None, None)
        return ticks, plant


def tick_of(message):
    return int.from_bytes(message.data[2:4], "little")


PACE = "design.tau_q_s=0.0027"  # the permitted bump depends on tau_q


def scenario_of(*changes, name="ideal"):
    return load(name, ["fault.kind=none", "duration_s=0.3", PACE, *changes])


def dstar_under(commands):
    """D* of the car of Table 3.2 under held commands, by scipy's zero-order hold."""
    a, b, c = vehicle_state_space(VehicleParameters())
    phi, gamma, *_ = cont2discrete((a, b, c, np.zeros((1, 2))), 0.001, "zoh")
    state, out = np.zeros(len(a)), []
    for pair in commands:
        out.append((c @ state).item())
        state = phi @ state + gamma @ pair
    return np.array(out)


def hold_up(world, by_ns):
    """Let the controller begin in time and take so much longer over the ticks of ``by_ns``."""
    world.held_up_ns = by_ns
