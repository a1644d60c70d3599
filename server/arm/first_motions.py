"""Speed of an arm whose calibration nobody has verified: a wrong zero is found at a quarter of the speed."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

from robot.messages import ChangePace
from server.arm.arms import ServedArm

log = logging.getLogger("armbridge.commissioning")

ADVICE = (
    "this calibration is not verified yet: no joint moves faster than {share:.0%} of its velocity limit until "
    "armbridge verify, or verify on the page, has found nothing (arm.unverified_speed_limit)"
)


class FirstMotions:
    """Speed limit of an arm on servos until its calibration is verified.

    Args:
        folder: folder with an empty file for each verified calibration, named by its digest.

    Attributes:
        advice: sentence for a person; empty for an arm without this limit.
    """

    def __init__(self, served: ServedArm, folder: Path) -> None:
        settings, file = served.settings, served.description.calibration_file
        self._arm = served.arm
        self._full = settings.speed_limit
        self._limit = min(settings.speed_limit, settings.unverified_speed_limit)
        self._mark: Path | None = None
        if settings.serial is not None and file is not None:
            trims = repr(sorted(settings.zero_offset_rad.items()))
            self._mark = folder / hashlib.sha256(file.read_bytes() + trims.encode()).hexdigest()
        limited = self._mark is not None and self._limit < self._full and not self._mark.exists()
        self.advice = ADVICE.format(share=self._limit) if limited else ""

    def begin(self) -> None:
        """Limit the speed, where the calibration is not verified."""
        if self.advice:
            log.warning("%s", self.advice)
            self._arm.change_pace(ChangePace(speed_limit=self._limit))

    def take_verified(self) -> None:
        """Take a verification without findings: the arm moves at its own speed limit, now and after a restart."""
        if self._mark is not None:
            try:
                self._mark.parent.mkdir(parents=True, exist_ok=True)
                self._mark.touch()
            except OSError as error:
                log.warning("the verification cannot be kept in %s: %s", self._mark.parent, error)
        # A limit that a client has chosen meanwhile stays.
        if self.advice and self._arm.state.pace.speed_limit == self._limit:
            self._arm.change_pace(ChangePace(speed_limit=self._full))
        self.advice = ""
