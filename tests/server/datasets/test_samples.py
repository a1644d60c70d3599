import numpy as np
import pytest

from server.datasets import samples as samples_module
from server.datasets.lerobot import QUANTILES, ImageStatistics
from server.datasets.samples import JointSample, read_samples, series, times_s
from server.errors import RecordingError
from tests.server.datasets.conftest import JOINTS, Record, state, states
from tests.server.recordings import REGISTRY


def test_a_message_that_does_not_fit_its_type_is_counted_and_more_samples_than_fit_are_refused(
    recorded: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = state(0.5)._replace(octets=b"\0\1\0\0\7")
    assert read_samples(recorded([state(0.0), broken]), REGISTRY).unreadable == 1
    monkeypatch.setattr(samples_module, "MAX_SAMPLES", 20)
    with pytest.raises(RecordingError, match="must have at most 20 states, goals and images"):
        read_samples(recorded(states(1.0)), REGISTRY)


def test_stamps_take_the_jitter_off_and_the_difference_of_clocks_where_they_can_be_used() -> None:
    stamps = np.arange(100.0, 101.0, 0.02)
    late = np.tile([0.0, 0.004], 25)
    times = times_s(stamps + 5000.0 + late, stamps)
    assert np.diff(times) == pytest.approx(0.02)
    assert times[0] == pytest.approx(5100.002)
    for unusable in ([0.0, 0.0, 0.0], [1.0, 0.0, 3.0], [1.0, 2.0, 4.2]):
        assert times_s([11.0, 12.0, 13.0], unusable).tolist() == [11.0, 12.0, 13.0], unusable


def test_joints_are_found_by_name_in_any_order_and_increasing_times() -> None:
    rows = [
        JointSample(3.0, 0.0, ("gripper", "shoulder_pan"), (0.5, 0.3)),
        JointSample(1.0, 0.0, JOINTS, (0.1, 0.5)),
        JointSample(1.0, 0.0, JOINTS, (0.7, 0.5)),
        JointSample(2.0, 0.0, ("shoulder_pan",), (0.2,)),
        JointSample(2.5, 0.0, JOINTS, (float("nan"), 0.5)),
    ]
    times, positions = series(rows, JOINTS)
    assert times.tolist() == [1.0, 3.0]
    assert positions.tolist() == [[0.1, 0.5], [0.3, 0.5]]


def test_statistics_of_images_are_those_of_their_pixels_in_all_frames() -> None:
    images = np.random.default_rng(1).integers(0, 256, size=(2, 20, 30, 3), dtype=np.uint8)
    statistics = ImageStatistics()
    statistics.add(images[0], 3)
    other = ImageStatistics()
    other.add(images[1])
    statistics.merge(other)
    told = statistics.result()
    pixels = np.concatenate([images[:1]] * 3 + [images[1:]]).reshape(-1, 3) / 255.0
    assert told["count"] == [4]
    assert np.shape(told["mean"]) == (3, 1, 1)
    for name in ("min", "max", "mean", "std"):
        assert np.ravel(told[name]) == pytest.approx(getattr(pixels, name)(axis=0))
    for name, share in QUANTILES.items():
        assert np.ravel(told[name]) == pytest.approx(np.quantile(pixels, share, axis=0), abs=1 / 255)
