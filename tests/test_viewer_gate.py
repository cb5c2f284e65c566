"""Which names a browser may use for this machine."""

import pytest

from services.viewer.gate import is_loopback, known_host

NAMES = {"localhost", "stage.example"}


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:80", "127.0.0.1:8080", "[::1]:8080", "192.168.1.7", "stage.example:8080"])
def test_numbers_and_known_names_pass(host):
    assert known_host(host, NAMES)


@pytest.mark.parametrize(
    "host",
    ["", "attacker.example", "localhost.attacker.example", "127.0.0.1.attacker.example", "[::1", "localhost:http", ":8080", "a@localhost.x",
     "127.0.0.1:99999999", "stage.example.", "0x7f.1"],
)  # fmt: skip
def test_others_do_not(host):
    assert not known_host(host, NAMES)


def test_who_reaches_an_address():
    assert all(is_loopback(host) for host in ("127.0.0.1", "127.8.8.8", "::1", "localhost"))
    assert not any(is_loopback(host) for host in ("0.0.0.0", "::", "10.1.2.3", "stage.example"))
