"""Coverage-guided fuzzing of a client's session, beside ``python -m tests.fuzz``: whatever arrives, nothing is raised.

Needs ``pip install atheris`` (Python 3.11 to 3.13). Usage:
``python tests/fuzz/fuzz_session.py tests/fuzz/corpus -runs=10000000``; libFuzzer's options follow the corpus.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).parents[2]))

with atheris.instrument_imports(include=["protocol"], enable_loader_override=False):
    from tests.fuzz.target import run_session


def main() -> None:
    """Fuzz for ever, or as libFuzzer's options say."""
    logging.disable(logging.CRITICAL)
    atheris.Setup(sys.argv, run_session)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
