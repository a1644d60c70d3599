"""Run of the whole server, which is killed or hangs during a motion."""

import asyncio
import random
import signal
from pathlib import Path

import psutil

from harness.clients import ArmClient, arm_client, values_of
from harness.server import RunningServer
from harness.write_log import Entry
from robot.messages import EndState
from tests.processes.campaign import checks
from tests.processes.campaign.emulator import CampaignBus, campaign_bus
from tests.processes.campaign.scenario import Happening, Result, Scenario, random_goal

RESULT_TOPIC = "/moveit_goal_result"
SUCCESS = 1

# Waiting for planners, planning, and the motion itself on a loaded machine.
ANSWER_S = 25.0

# Into a motion, which takes a second or two.
IN_THE_MIDST_S = 0.5

# Longer than the watchdog (0.5 s), braking (1 s) and relaxing take; servos with a return delay are relaxed in 2.3 s,
# and later beside other processes.
SILENCE_S = 6.0

# Braking, relaxing, and ending.
END_S = 8.0

# Time for resetting faults and enabling, and the period of the check.
RECOVERY_S = 10.0
LOOK_S = 0.1
REMEDY = {"fault": "/arm/reset_fault", "relaxed": "/arm/enable"}

# At rest, goals do not change for this time.
REST_S = 0.2


class ServerRun:
    """One run, of one server after the other on one arm."""

    def __init__(self, scenario: Scenario, bus: CampaignBus) -> None:
        self.result = Result(scenario.seed, scenario.happening.value, scenario.population)
        self._scenario = scenario
        self._bus = bus
        self._chance = random.Random(scenario.seed)

    async def play(self) -> list[Entry]:
        """Kill a server and start the next one, or hang a server; returns the log of writes to the servos."""
        with self._server() as server:
            async with arm_client(server.url) as client:
                await client.until_mode("holding")
                await self._goal(client)
                self._bus.strike(self._scenario)
                if self._scenario.happening is Happening.SERVER_FROZEN:
                    await self._freeze(server, client)
                    await self._go_on(client)
                else:
                    await self._kill(server, client)
        if self._scenario.happening is Happening.SERVER_KILLED:
            with self._server() as server:
                async with arm_client(server.url) as client:
                    await self._go_on(client)
        return self._bus.entries()

    def _server(self) -> RunningServer:
        lost = self._scenario.on_server_lost.value
        return RunningServer(
            f"--port 0 --serial {self._bus.port} --calibration nominal", {"ARMBRIDGE_ARM__ON_SERVER_LOST": lost}
        )

    async def _kill(self, server: RunningServer, client: ArmClient) -> None:
        await self._begin_goal(client)
        children = psutil.Process(server.process.pid).children(recursive=True)
        arm = [child for child in children if "robot.control.loop" in child.cmdline()]
        server.end(signal.SIGKILL)
        _, left = await asyncio.to_thread(psutil.wait_procs, arm, END_S)
        if left:
            self.result.violations.append(f"the arm process did not end within {END_S:g} s of its server's death")
        self._check_end_state()

    async def _freeze(self, server: RunningServer, client: ArmClient) -> None:
        await self._begin_goal(client)
        server.process.send_signal(signal.SIGSTOP)
        await asyncio.sleep(SILENCE_S)
        self._check_end_state()
        server.process.send_signal(signal.SIGCONT)
        await self._answer(client, 2)

    async def _go_on(self, client: ArmClient) -> None:
        """Check that the next goal succeeds once the faults have ended."""
        self._bus.calm(self._scenario)
        await self._enable(client)
        if await self._goal(client) != SUCCESS:
            self.result.violations.append(f"the arm did not go on: {client.topics[RESULT_TOPIC][-1]}")

    async def _enable(self, client: ArmClient) -> None:
        """Reset faults and enable the arm, as an operator would, until it holds."""
        states = await client.until("/arm/state", bool)
        async with asyncio.timeout(RECOVERY_S):
            while (mode := values_of(states[-1])["mode"]) != "holding":
                if mode in REMEDY:
                    await client.call(REMEDY[mode])
                await asyncio.sleep(LOOK_S)

    async def _begin_goal(self, client: ArmClient) -> None:
        await self._send_goal(client)
        await asyncio.sleep(IN_THE_MIDST_S)

    async def _send_goal(self, client: ArmClient) -> None:
        moves = {name: position for name, position in random_goal(self._chance).items() if name != "gripper"}
        moves = moves or {"wrist_roll": 0.2}
        msg = {"name": list(moves), "position": list(moves.values())}
        await client.goal("/moveit_goal_joints", "sensor_msgs/JointState", msg)

    async def _goal(self, client: ArmClient) -> int | None:
        before = len(client.topics.get(RESULT_TOPIC, []))
        await self._send_goal(client)
        return await self._answer(client, before + 1)

    async def _answer(self, client: ArmClient, number: int) -> int | None:
        """Return the error code of the only result of the goal with this number."""
        try:
            results = await client.until(RESULT_TOPIC, lambda results: len(results) >= number, ANSWER_S)
        except TimeoutError:
            self.result.violations.append(f"a goal had no answer in {ANSWER_S:g} s")
            return None
        if len(results) > number:
            self.result.violations.append(f"{number} goals had {len(results)} answers")
        code = int(results[number - 1]["val"])
        self.result.count(str(code))
        return code

    def _check_end_state(self) -> None:
        """Check that the arm is at rest, and holds or is relaxed as configured."""
        entries = self._bus.entries()
        torque = {0} if self._scenario.on_server_lost is EndState.RELAX else {1}
        last = entries[-1]
        if set(last.torque.values()) != torque:
            self.result.violations.append(f"without a server the torque is {last.torque}, not {torque}")
        moving = [entry for entry in entries if entry.at_s > last.at_s - REST_S and entry.goal != last.goal]
        if moving and torque == {1}:
            self.result.violations.append("without a server the goals still change")


async def run_server(scenario: Scenario, folder: Path) -> Result:
    """Run a scenario in which a server is lost."""
    with campaign_bus(scenario, folder) as bus:
        run = ServerRun(scenario, bus)
        entries = await run.play()
    run.result.writes = len(entries)
    run.result.violations += [*checks.goal_steps(entries), *checks.limits(entries), *checks.torque_on(entries)]
    return run.result
