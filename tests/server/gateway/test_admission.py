from ipaddress import ip_address

import pytest
from websockets.datastructures import Headers

from server.access.authentication import MAX_WRONG, WINDOW_S, Tokens
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.errors import ConfigurationError
from server.gateway.admission import (
    AdmissionPolicy,
    Authority,
    HandshakeRequest,
    check_exposure,
    host_addresses,
    is_server,
    may_connect,
    own_names,
    read_authority,
)
from server.gateway.http import HttpResponse
from server.graph.permissions import ANYONE, Identity, Role
from tests.helpers.clock import FakeClock

SECRET, OTHER = "correct-horse-battery", "another-token-of-mine"
ALICE = Identity("alice", Role.OPERATE)
LOCKED = Access(AccessSettings.model_validate({"operate_tokens": {"alice": SECRET}}))
VIEWED = Access(LOCKED.settings.model_copy(update={"without_token": "view"}))
OPEN = Access(AccessSettings())
FOREIGN = "Origin", "http://evil.com"


def request_for(
    path: str = "/", *headers: tuple[str, str], host: str = "localhost:9090", upgrade: bool = True, address: str = "::1"
) -> HandshakeRequest:
    return HandshakeRequest(address, path, Headers([("Host", host), *headers]), upgrade=upgrade)


def plain(path: str, *headers: tuple[str, str]) -> HandshakeRequest:
    return request_for(path, *headers, upgrade=False)


def refused(admitted: object) -> tuple[int, str]:
    assert isinstance(admitted, HttpResponse), admitted
    return admitted.status, admitted.body.decode()


REBOUND = 421, 'set access.allowed_hosts = ["evil.com"]', "'Evil.com:9090' is no name of this server"


@pytest.mark.parametrize(
    ("asked", "status", "remedy", "logged"),
    [
        (request_for(host="Evil.com:9090"), *REBOUND),
        (request_for(host="Evil.com:9090", upgrade=False), *REBOUND),
        (request_for("/", FOREIGN), 403, 'set access.allowed_origins = ["http://evil.com"]', "m' may not connect"),
    ],
)
def test_a_rebound_name_and_a_foreign_page_are_refused_with_the_setting_to_change(
    asked: HandshakeRequest, status: int, remedy: str, logged: str, caplog: pytest.LogCaptureFixture
) -> None:
    policy = AdmissionPolicy(OPEN)
    for _ in range(2):
        got, text = refused(policy.check(asked))
        assert got == status
        assert remedy in text
    assert caplog.text.count(logged) == 1


def test_pages_of_a_classrooms_other_servers_may_connect() -> None:
    host, own = Authority("10.0.0.2", 9100), "http://10.0.0.2:9101"
    pages = (own, "http://10.0.0.2:9102", "https://10.0.0.2:9101", "http://evil.com:9101")
    assert [page for page in pages if may_connect(page, host, (), [9100, 9101], encrypted=False)] == [own]


def test_a_token_admits_its_owner() -> None:
    for access, asked, admitted in (
        (LOCKED, request_for("/", ("Authorization", f"Bearer {SECRET}")), ALICE),
        (LOCKED, request_for("/", ("Authorization", f"bearer  {SECRET} ")), ALICE),
        (LOCKED, request_for(f"/any/path?x=1&token={SECRET}"), ALICE),
        (LOCKED, request_for(f"/?token={SECRET}", ("Authorization", f"Bearer {SECRET}")), ALICE),
        (LOCKED, request_for(), None),
        (LOCKED, request_for("/", ("Authorization", "Basic YTpi")), None),
        (VIEWED, request_for(), VIEWED.tokens.anonymous),
        (OPEN, request_for(f"/?token={OTHER}"), ANYONE),
        (OPEN, plain("/robot/description.urdf", FOREIGN), ANYONE),
        *((LOCKED, plain(path), None) for path in ("/", "/index.html", "/assets/vendor.js", "/healthz", "/livez")),
    ):
        assert AdmissionPolicy(access).check(asked) == admitted


def test_a_request_is_refused_with_its_reason() -> None:
    for access, asked, status, words in (
        (OPEN, HandshakeRequest("::1", "/", Headers(), upgrade=True), 400, "one Host header, not 0"),
        (OPEN, request_for("/", ("Host", "localhost")), 400, "one Host header, not 2"),
        (OPEN, request_for("/", ("Host", "evil.com")), 400, "one Host header, not 2"),
        (OPEN, request_for("/", ("Origin", "http://localhost"), FOREIGN), 403, "may not connect"),
        (LOCKED, request_for(f"/?token={SECRET}", FOREIGN), 403, "may not connect"),
        (OPEN, request_for("/robot/description.urdf", FOREIGN), 403, "may not connect"),
        *((OPEN, plain(path, FOREIGN), 403, "") for path in ("/", "/metrics", "/healthz", "/robots", "//robot/x")),
        (LOCKED, request_for(f"/?token={SECRET}&token={OTHER}"), 401, "one token is wanted, not 2"),
        (OPEN, request_for("/?on_disconnect=halt"), 400, "?on_disconnect= must be finish or stop, not 'halt'"),
        (OPEN, request_for("/?ros=1&ros=noetic"), 400, "?ros= must be 1 or 2, not 'noetic'"),
        (OPEN, request_for("/?on_disconnect="), 400, "?on_disconnect= must be finish or stop, not ''"),
    ):
        got, text = refused(AdmissionPolicy(access).check(asked))
        assert got == status
        assert words in text


@pytest.mark.parametrize("path", [f"/?token={OTHER}", "/?token=", f"/?token={SECRET[:-1]}", f"/?token={SECRET}%00"])
@pytest.mark.parametrize("access", [LOCKED, VIEWED])
def test_a_wrong_token_is_refused_and_not_logged(path: str, access: Access, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG")
    admitted = AdmissionPolicy(access).check(request_for(path))
    assert refused(admitted) == (401, "invalid token\n")
    assert admitted.headers["WWW-Authenticate"] == "Bearer"
    assert "::1 has shown an invalid token" in caplog.text
    assert path[8:24] not in caplog.text or path == "/?token="


def test_after_many_wrong_tokens_even_the_right_one_is_refused_for_a_while() -> None:
    clock = FakeClock()
    policy = AdmissionPolicy(Access(LOCKED.settings, clock))
    for number in range(MAX_WRONG):
        assert refused(policy.check(request_for(f"/?token={OTHER}{number}", address="192.0.2.1")))[0] == 401
    right = request_for(f"/?token={SECRET}", address="192.0.2.1")
    admitted = policy.check(right)
    assert refused(admitted)[0] == 429
    assert admitted.headers["Retry-After"] == "60"
    assert policy.check(request_for(f"/?token={SECRET}", address="192.0.2.2")) == ALICE
    clock.advance(WINDOW_S)
    assert policy.check(right) == ALICE


def test_paths_that_tell_of_the_robot_need_a_token_and_those_without_sense_let_nobody_in() -> None:
    told = ("/metrics", "/goal", "/armbridge/x", "/robot/description.urdf", "/%6detrics", "/robot", "/metrics?x=1")
    for path in told:
        status, text = refused(AdmissionPolicy(LOCKED).check(plain(path)))
        assert (status, "needs a token" in text) == (401, True), path
        asked = path + ("&" if "?" in path else "?") + f"token={SECRET}"
        assert AdmissionPolicy(LOCKED).check(plain(asked)) == ALICE, path
        assert AdmissionPolicy(VIEWED).check(plain(path)) == VIEWED.tokens.anonymous, path
    for path in ("//[", "/%ff%00?token", "?", "", "/?%", "http://[x/?token=a"):
        for upgrade in (True, False):
            assert not isinstance(AdmissionPolicy(LOCKED).check(request_for(path, upgrade=upgrade)), Identity), path


def authority_of(text: str) -> Authority:
    authority = read_authority(text)
    assert authority is not None
    return authority


def test_the_server_has_its_addresses_and_the_names_of_its_machine() -> None:
    ours = ["localhost:9090", "LOCALHOST", "localhost.", "127.0.0.1:9090", "[::1]:9090", "[fe80::1%eth0]:9090"]
    # Browsers take 127.0.0.1. for the address, too, and ask nobody.
    ours += ["192.168.0.2", "127.0.0.1.", "ROBOT.lab:9090", "robot:9090", "robot.local"]
    others = ("evil.com:9090", "localhost.evil.com", "127.0.0.1.evil.com", "evil.local", "lab")
    names = own_names("robot.lab")
    assert [text for text in (*ours, *others) if is_server(authority_of(text), names)] == ours
    assert own_names("Robot.lab.example") == ("robot.lab.example", "robot", "robot.local")
    assert own_names("robot") == ("robot", "robot", "robot.local")
    assert own_names("") == ()
    assert own_names()


def test_further_names_are_allowed_by_pattern() -> None:
    for allowed, ours, others in (
        ("arm.example.org", "arm.example.org:1234", ""),
        ("Arm.Example.Org", "arm.example.org", ""),
        ("arm.example.org:443", "arm.example.org:443", "arm.example.org:444 arm.example.org"),
        ("*.example.org", "arm.example.org:9090", "example.org.evil.com"),
        ("*", "evil.com", ""),
    ):
        assert is_server(authority_of(ours), (), [allowed]), allowed
        assert not any(is_server(authority_of(text), (), [allowed]) for text in others.split()), allowed


def is_allowed(origin: str, *allowed: str, host: str = "robot.lab:9090", encrypted: bool = False) -> bool:
    return may_connect(origin, authority_of(host), allowed, encrypted=encrypted)


LOCAL_HOSTS = ("localhost", "localhost:3000", "127.0.0.1:8000", "127.8.9.1", "[::1]:5173")
LOOK_LOCAL = ("localhost.evil.com", "127.0.0.1.evil.com", "localhost@evil.com", "evil.com#localhost")
NO_ORIGINS = ("null", "file://", "", "localhost", "//localhost", "ftp://localhost", "chrome-extension://localhost")


def test_pages_of_this_machine_may_connect_whatever_their_port_and_other_pages_may_not() -> None:
    local = [*(f"http://{host}" for host in LOCAL_HOSTS), "https://LOCALHOST:8443"]
    with_path = ["http://localhost:3000/", "http://localhost:3000/page", "http://localhost http://evil.com"]
    others = ["http://evil.com", "https://evil.com:9090", "http://192.168.0.2", "http://0.0.0.0:9090", *with_path]
    others += [f"http://{host}" for host in (*LOOK_LOCAL, "evil.com/localhost")]
    assert [origin for origin in (*local, *others, *NO_ORIGINS) if is_allowed(origin)] == local


def test_the_server_s_page_is_known_by_scheme_host_and_port() -> None:
    for origin, host, encrypted, own in (
        ("http://robot.lab:9090", "robot.lab:9090", False, True),
        ("http://Robot.Lab:9090", "robot.lab.:9090", False, True),
        ("http://robot.lab", "robot.lab:80", False, True),
        ("http://robot.lab:80", "robot.lab", False, True),
        ("https://robot.lab", "robot.lab:443", True, True),
        ("http://[fd00::1]:9090", "[fd00:0::1]:9090", False, True),
        ("http://robot.lab", "robot.lab:9090", False, False),
        ("http://robot.lab:9091", "robot.lab:9090", False, False),
        ("https://robot.lab:9090", "robot.lab:9090", False, False),
        ("http://robot.lab:9090", "robot.lab:9090", True, False),
        ("http://evil.com:9090", "robot.lab:9090", False, False),
    ):
        assert is_allowed(origin, host=host, encrypted=encrypted) is own


def test_further_pages_are_allowed_by_pattern() -> None:
    foxglove = "https://app.foxglove.dev"
    for allowed, pages, others in (
        (foxglove, foxglove, f"http://app.foxglove.dev {foxglove}.evil.com"),
        (f"{foxglove}/", "https://APP.foxglove.dev", ""),
        ("https://*.lab.example", "https://a.lab.example", "https://lab.example https://a.lab.example.evil.com"),
        ("null", "null", ""),
        # Only the asterisk is special.
        ("http://[2001:db8::1]", "http://[2001:db8::1]", "http://2"),
        ("http*", "", "null"),
        ("*", "null http://evil.com", ""),
        ("file://", "file://", ""),
    ):
        assert all(is_allowed(page, allowed) for page in pages.split()), allowed
        assert not any(is_allowed(page, allowed) for page in others.split()), allowed


WITH_TOKEN = Tokens({SECRET: Identity("admin", Role.ADMIN)}, None)
EVERYWHERE = ["0.0.0.0"]


def test_an_insecure_address_is_warned_of_at_each_start_and_no_other(caplog: pytest.LogCaptureFixture) -> None:
    for addresses in (["127.0.0.1"], ["127.0.0.1", "::1"], ["127.1.2.3"]):
        check_exposure("localhost", addresses, OPEN.tokens, insecure=False)
    assert not caplog.records
    check_exposure("0.0.0.0", EVERYWHERE, WITH_TOKEN, insecure=False)
    assert not caplog.records
    for _ in range(2):
        check_exposure("0.0.0.0", EVERYWHERE, OPEN.tokens, insecure=True)
    assert caplog.text.count("INSECURE: anyone at 0.0.0.0 may connect without a token as admin") == 2


@pytest.mark.parametrize("addresses", [EVERYWHERE, ["::"], ["192.168.0.2"], ["127.0.0.1", "192.168.0.2"], ["fe80::1"]])
def test_a_public_address_needs_a_token_or_the_option_insecure(addresses: list[str]) -> None:
    with pytest.raises(ConfigurationError) as refused:
        check_exposure("robot", addresses, OPEN.tokens, insecure=False)
    assert all(words in str(refused.value) for words in ("ARMBRIDGE_ACCESS__TOKEN", "--insecure", addresses[-1]))


def test_anonymous_operators_need_the_option_insecure_and_viewers_do_not(caplog: pytest.LogCaptureFixture) -> None:
    check_exposure("robot", EVERYWHERE, VIEWED.tokens, insecure=False)
    assert not caplog.records
    moving = Tokens({SECRET: ALICE}, Identity("", Role.OPERATE))
    check_exposure("robot", EVERYWHERE, moving, insecure=True)
    assert "as operate" in caplog.text
    with pytest.raises(ConfigurationError, match=r"access\.without_token: .* set it to view or none"):
        check_exposure("robot", EVERYWHERE, moving, insecure=False)


WRONG_PORTS = [":9090", "localhost:", "localhost:x", "localhost:65536", "localhost:9090:1"]
WITH_MORE = [f"localhost{more}" for more in ("/", "#evil.com", "\\evil.com", "\n", "..", ",evil.com", ":9090@evil.com")]
NO_ADDRESSES = ["::1", "[::1", "[127.0.0.1]", "[::x]"]
NO_NAMES = ["", "user@localhost", "local host", " localhost", ".", "löcalhost", "a" * 256]


def test_an_invalid_host_is_none() -> None:
    assert [text for text in WRONG_PORTS + WITH_MORE + NO_ADDRESSES + NO_NAMES if read_authority(text)] == []


def test_a_one_time_token_reads_files_while_its_connection_is_open_and_opens_none_by_the_handshake() -> None:
    policy, one_time = AdmissionPolicy(access := Access(LOCKED.settings)), access.one_time_tokens
    token = one_time.issue(ANYONE, "operate")
    header = "Authorization", f"Bearer {token}"
    assert refused(policy.check(request_for("/robot/x", header, upgrade=False)))[0] == 401
    one_time.use(token)
    assert policy.check(request_for("/robot/x", header, upgrade=False)) == Identity("one-time-1", Role.VIEW)
    assert refused(policy.check(request_for("/", header, upgrade=True)))[0] == 401


def test_addresses_of_this_machine_are_those_that_others_can_reach() -> None:
    found = [ip_address(text) for text in host_addresses()]
    assert [address for address in found if address.is_loopback or address.is_link_local] == []
