"""Changes the source in one place at a time and counts how many of the changes a test notices: `make mutation`.

The changes are drawn by seed from all that cosmic-ray knows, and made in copies of the commit, in build/mutation.
Printed are the share that is noticed in each package, with its standard error, and every change that no test notices.
"""

import argparse
import math
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
COPIES = ROOT / "build" / "mutation"
# cosmic-ray has an environment of its own.
PYTHON = ROOT / ".venv" / "bin" / "python"

# What is changed, and the tests that are to notice it.
PACKAGES = {
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


def copied(package: str) -> Path:
    """Return a new folder of what is committed, with this environment."""
    folder = COPIES / package.replace("/", "-")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True)
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive.stdout, check=True)
    (folder / ".venv").symlink_to(ROOT / ".venv")
    return folder


def run(package: str, number: int, seed: int) -> Counter[str]:
    """Try changes of one package; return how many were noticed and how many not."""
    folder = copied(package)
    configuration, session = folder / "mutation.toml", folder / "mutation.sqlite"
    # Servers that the tests start are changed too: the environment's own source comes after this path.
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    tests = f"{PYTHON} -m pytest -x -q -n 0 -p no:cacheprovider {PACKAGES[package]}"
    configuration.write_text(
        f'[cosmic-ray]\nmodule-path = "{package}"\ntimeout = {TIMEOUT_S}\nexcluded-modules = []\n'
        f'test-command = "{tests}"\n[cosmic-ray.distributor]\nname = "local"\n'
    )
    cosmic_ray = [str(Path(sys.executable).with_name("cosmic-ray"))]
    unchanged = subprocess.run(tests.split(), cwd=folder, check=False, capture_output=True, text=True, env=environment)
    if unchanged.returncode != 0:
        sys.exit(f"{package}: the tests fail without a change\n{unchanged.stdout}")
    subprocess.run([*cosmic_ray, "init", configuration.name, session.name], cwd=folder, check=True)
    with use_db(str(session), WorkDB.Mode.open) as database:
        sampled(database, number, seed)
    subprocess.run([*cosmic_ray, "exec", configuration.name, session.name], cwd=folder, check=True, env=environment)
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
    """Try changes of every package that is named, or of all."""
    parser = argparse.ArgumentParser(prog="make mutation", description=__doc__)
    parser.add_argument("packages", nargs="*", metavar="PACKAGE", choices=[*PACKAGES, []], help=", ".join(PACKAGES))
    parser.add_argument("--changes", type=int, default=40, metavar="N", help="changes of each package (40)")
    parser.add_argument("--seed", type=int, default=1, help="which changes (1)")
    options = parser.parse_args()
    for package in options.packages or PACKAGES:
        found = run(package, options.changes, options.seed)
        share = found["noticed"] / found.total()
        error = math.sqrt(share * (1.0 - share) / found.total())
        noticed = f"{found['noticed']} of {found.total()} changes were noticed"
        print(f"{package}: {noticed}, {share:.0%} with a standard error of {error:.0%}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
