from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from protocol.errors import InterfaceError
from protocol.registry import Registry
from protocol.type_hash import message_hash, service_hash

REGISTRY = Registry.load()

# As ROS 2 Jazzy has them (share/<package>/<msg or srv>/<name>.json), and its documentation prints some.
PUBLISHED = {
    "std_msgs/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    # Without fields, and with a char.
    "std_msgs/Empty": "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "std_msgs/Char": "3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
    "sensor_msgs/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
}
PUBLISHED_SERVICES = {
    "std_srvs/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "std_srvs/SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "std_srvs/Empty": "5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19",
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_message_has_the_hash_that_ros_publishes(name: str) -> None:
    assert message_hash(REGISTRY, name) == f"RIHS01_{PUBLISHED[name]}"


@pytest.mark.parametrize("name", PUBLISHED_SERVICES)
def test_a_service_has_the_hash_that_ros_publishes(name: str) -> None:
    assert service_hash(REGISTRY, name) == f"RIHS01_{PUBLISHED_SERVICES[name]}"


def test_every_message_that_rosbags_knows_too_has_the_same_hash_there() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    # rosbags takes a char for a type of its own, which no definition in ROS 2 makes one.
    shared = {name for name in REGISTRY.type_names() if name in store.fielddefs} - {"std_msgs/msg/Char"}
    assert len(shared) > 100
    assert [name for name in shared if message_hash(REGISTRY, name) != store.hash_rihs01(name)] == []


def test_every_type_has_a_hash() -> None:
    hashes = set()
    for name in REGISTRY.type_names():
        if "/action/" not in name:
            hashes.add((service_hash if "/srv/" in name else message_hash)(REGISTRY, name))
    assert len(hashes) > 250


def test_an_unknown_type_has_no_hash() -> None:
    with pytest.raises(InterfaceError):
        message_hash(REGISTRY, "nobodys_msgs/Thing")
    with pytest.raises(InterfaceError):
        service_hash(REGISTRY, "std_msgs/String")
