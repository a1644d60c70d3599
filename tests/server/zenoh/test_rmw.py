import zenoh.ext

from server.zenoh.rmw import Attachment, Endpoint, Entity, EntityKind, LivelinessTokens, is_name

# Keys and tokens; the examples are those of ros2/rmw_zenoh, docs/design.md.

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
ADD_HASH = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
CHATTER = Endpoint("/chatter", "std_msgs/msg/String", STRING_HASH)
ADD = Endpoint("/add_two_ints", "example_interfaces/srv/AddTwoInts", ADD_HASH)

TALKER = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/"
    f"{STRING_HASH}/::,7:,:,:,,"
)
ADDER = (
    "@ros2_lv/2/f9980ee0495eaafb3e38f0d19e2eae12/0/10/SS/%/%/add_two_ints_server/%add_two_ints/"
    f"example_interfaces::srv::dds_::AddTwoInts_/{ADD_HASH}/::,10:,:,:,,"
)


def test_topics_services_and_nodes_have_the_keys_of_rmw_zenoh_and_tokens_a_number_each() -> None:
    robot = Endpoint("/robot1/chatter", "std_msgs/msg/String", STRING_HASH)
    assert CHATTER.key(0) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    assert robot.key(0) == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    assert ADD.key(2) == f"2/add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/{ADD_HASH}"
    assert LivelinessTokens(2, "aac3", "").node() == "@ros2_lv/2/aac3/0/0/NN/%/%/armbridge"
    assert LivelinessTokens(2, "aac3", "/arm1").node() == "@ros2_lv/2/aac3/0/0/NN/%/%arm1/armbridge"
    tokens = LivelinessTokens(0, "aac3", "")
    first, second = tokens.entity(EntityKind.SUBSCRIPTION, CHATTER), tokens.entity(EntityKind.SUBSCRIPTION, CHATTER)
    behind = f"MS/%/%/armbridge/%chatter/std_msgs::msg::dds_::String_/{STRING_HASH}/::,10:,:,:,,"
    assert (first, second) == (f"@ros2_lv/0/aac3/0/1/{behind}", f"@ros2_lv/0/aac3/0/2/{behind}")


def test_tokens_of_rmw_zenoh_are_read_but_of_neither_topics_nor_services() -> None:
    assert Entity.parse(TALKER) == Entity(
        EntityKind.PUBLISHER, "8b20917502ee955ac4476e0266340d5c", CHATTER, latched=False
    )
    assert Entity.parse(ADDER) == Entity(EntityKind.SERVICE, "f9980ee0495eaafb3e38f0d19e2eae12", ADD, latched=False)
    others = [
        "",
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener",
        TALKER.replace("@ros2_lv", "@adv"),
        TALKER.replace("/MP/", "/XX/"),
        TALKER.replace("%chatter", "chatter"),
        TALKER.replace("%chatter", "%**"),
        TALKER.replace("%chatter", "%" + "c" * 2048),
        TALKER.replace("::dds_::", "::"),
    ]
    assert [token for token in others if Entity.parse(token) is not None] == []


def test_characters_with_a_meaning_in_keys_are_no_part_of_names() -> None:
    names = ["/joint_states", "/arm1/joint_states", "/_hidden"]
    others = ["", "/", "joint_states", "/a//b", "/a/", "/*", "/a/**", "/a$*", "/1a", "/a b", "/ä"]
    assert [name for name in (*names, *others) if is_name(name)] == names


GID = bytes(range(16))


def test_an_attachment_is_written_as_zenoh_serializes_its_parts_and_other_octets_are_none() -> None:
    attachment = Attachment(3, 1_700_000_000_000_000_001, GID)
    parts = (zenoh.ext.Int64(attachment.sequence_number), zenoh.ext.Int64(attachment.source_timestamp_ns), GID)
    assert attachment.encode() == bytes(zenoh.ext.z_serialize(parts))
    assert Attachment.decode(attachment.encode()) == attachment
    written = Attachment(7, 12, GID).encode()
    others = (b"", written + b"\0", written[:16] + b"\x0f" + GID)
    assert [Attachment.decode(octets) for octets in others] == [None] * 3
