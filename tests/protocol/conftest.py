import pytest

from protocol.registry import Registry


@pytest.fixture(scope="session")
def registry() -> Registry:
    return Registry.load()
