from __future__ import annotations

import pytest

from server.moveit.services.move_group_services import OFFERS
from tests.helpers.arm_server import ArmClient
from tests.helpers.messages import made_up
from tests.helpers.moveit_requests import TIP
from tests.helpers.moveit_services import REGISTRY, ServiceRig


@pytest.fixture
def rig() -> ServiceRig:
    return ServiceRig()


def test_every_service_is_offered_with_moveits_type(rig: ServiceRig) -> None:
    for name, offer in OFFERS.items():
        assert rig.graph.services.type_of(name) == offer.type_name


@pytest.mark.parametrize("name", OFFERS)
async def test_a_request_that_says_nothing_is_answered(rig: ServiceRig, name: str) -> None:
    ok, values = await rig.outcome(name)
    assert ok, values


@pytest.mark.parametrize("name", OFFERS)
async def test_a_request_for_an_arm_that_is_not_read_is_answered(rig: ServiceRig, name: str) -> None:
    rig.arm.at_rad = None
    ok, values = await rig.outcome(name)
    assert ok, values


@pytest.mark.parametrize("name", OFFERS)
async def test_nonsense_is_answered_too(rig: ServiceRig, name: str) -> None:
    for seed in range(10):
        _, values = await rig.outcome(name, **made_up(REGISTRY, f"{OFFERS[name].type_name}_Request", seed))
        assert "inside the server" not in str(values)


async def test_a_running_server_offers_them(client: ArmClient) -> None:
    answer = await client.call("/compute_fk", fk_link_names=[TIP])
    assert answer["fk_link_names"] == [TIP]
    goal = {"joint_constraints": [{"joint_name": "shoulder_pan", "position": 0.2}]}
    planned = await client.call("/plan_kinematic_path", motion_plan_request={"goal_constraints": [goal]})
    assert planned["motion_plan_response"]["error_code"]["val"] == 1
