"""Changes the source in one place at a time and counts how many of the changes a test notices: `make mutation`.

The changes are drawn by seed from all that cosmic-ray knows, and made in build/mutation, a copy of what is committed.
Printed are the share that is noticed in each room and, as a diff, every change that no test notices.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkerOutcome, WorkResult

ROOT = Path(__file__).resolve().parent.parent
COPY = ROOT / "build" / "mutation"
# cosmic-ray has an environment of its own.
PYTHON = ROOT / ".venv" / "bin" / "python"

# What is changed, and the tests that are to notice it.
ROOMS = {
    "protocol/session.py": "tests/protocol/test_session.py",
    "server/access": "tests/server/access",
    "server/execution": "tests/server/execution",
    "robot/control": "tests/robot/control",
}
# A change of `int | None` in an annotation changes nothing: annotations are not evaluated.
ANNOTATIONS = "ReplaceBinaryOperator_BitOr"
TIMEOUT_S = 300


def sampled(database: WorkDB, number: int, seed: int) -> None:
    """Leave so many changes to be tried."""
    jobs = sorted(
        (item.mutations[0].module_path, item.mutations[0].operator_name, item.mutations[0].occurrence, item.job_id)
        for item in database.work_items
    )
    tried = [job[-1] for job in jobs if ANNOTATIONS not in job[1]]
    chosen = set(random.Random(seed).sample(tried, min(number, len(tried))))
    skipped = [job[-1] for job in jobs if job[-1] not in chosen]
    database.set_multiple_results(skipped, WorkResult(WorkerOutcome.SKIPPED))


def run(room: str, number: int, seed: int) -> Counter[str]:
    """Try changes of one room; return how many were noticed and how many not."""
    configuration, session = COPY / "mutation.toml", COPY / "mutation.sqlite"
    tests = f"{PYTHON} -m pytest -x -q -n 0 -p no:cacheprovider {ROOMS[room]}"
    configuration.write_text(
        f'[cosmic-ray]\nmodule-path = "{room}"\ntimeout = {TIMEOUT_S}\nexcluded-modules = []\n'
        f'test-command = "{tests}"\n[cosmic-ray.distributor]\nname = "local"\n'
    )
    session.unlink(missing_ok=True)
    cosmic_ray = [str(Path(sys.executable).with_name("cosmic-ray"))]
    # Without a change they pass.
    subprocess.run(tests.split(), cwd=COPY, check=True, stdout=subprocess.DEVNULL)
    subprocess.run([*cosmic_ray, "init", configuration.name, session.name], cwd=COPY, check=True)
    with use_db(str(session), WorkDB.Mode.open) as database:
        sampled(database, number, seed)
    subprocess.run([*cosmic_ray, "exec", configuration.name, session.name], cwd=COPY, check=True)
    found: Counter[str] = Counter()
    with use_db(str(session), WorkDB.Mode.open) as database:
        for _, result in database.results:
            if result.worker_outcome is WorkerOutcome.SKIPPED:
                continue
            noticed = result.test_outcome is not TestOutcome.SURVIVED
            found["noticed" if noticed else "not noticed"] += 1
            if not noticed:
                print(result.diff, flush=True)
    return found


def main() -> int:
    """Try changes of every room that is named, or of all."""
    parser = argparse.ArgumentParser(prog="make mutation", description=__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM", choices=[*ROOMS, []], help=", ".join(ROOMS))
    parser.add_argument("--changes", type=int, default=40, metavar="N", help="changes of each room (40)")
    parser.add_argument("--seed", type=int, default=1, help="which changes (1)")
    options = parser.parse_args()
    shutil.rmtree(COPY, ignore_errors=True)
    COPY.mkdir(parents=True)
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True)
    subprocess.run(["tar", "-x", "-C", str(COPY)], input=archive.stdout, check=True)
    # Servers that the tests start are changed too: the environment's own source comes after the path.
    (COPY / ".venv").symlink_to(ROOT / ".venv")
    os.environ["PYTHONPATH"] = str(COPY)
    for room in options.rooms or ROOMS:
        found = run(room, options.changes, options.seed)
        print(f"{room}: {found['noticed']} of {found.total()} changes were noticed", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
