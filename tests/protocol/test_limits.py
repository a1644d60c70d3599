from protocol.limits import MAX_SERVER_QUEUED_BYTES, Limits


def test_a_client_that_stops_reading_has_a_quarter_of_the_servers_memory_for_what_waits_at_most():
    assert Limits().max_queued_bytes <= MAX_SERVER_QUEUED_BYTES / 4


def test_replies_and_requests_leave_room_for_topic_data():
    limits = Limits()
    assert limits.max_queued_request_bytes + limits.max_queued_reply_bytes < limits.max_queued_bytes
