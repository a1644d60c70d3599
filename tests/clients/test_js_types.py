"""clients/js: the declarations are those of the type tables, and roslib's users can write with them."""

import shutil
from pathlib import Path

import pytest

from clients.js.generate_types import TARGET, generated
from harness.server import ROOT
from tests.helpers.programs import install_with_npm, run
from tests.test_readme import blocks

TSC = ROOT / "server" / "page" / "node_modules" / ".bin" / "tsc"


def test_the_declarations_are_those_of_the_type_tables() -> None:
    assert TARGET.read_text() == generated(), "run .venv/bin/python -m clients.js.generate_types"


@pytest.mark.skipif(not TSC.exists() or shutil.which("npm") is None, reason="no TypeScript: make page installs it")
def test_the_program_of_the_readme_is_well_typed_with_roslib(tmp_path: Path) -> None:
    (program,) = blocks(TARGET.with_name("README.md"), "ts")
    (tmp_path / "program.ts").write_text(program)
    shutil.copy(TARGET, tmp_path)
    (tmp_path / "package.json").write_text('{"type":"module","dependencies":{"roslib":"2.1.0"}}')
    install_with_npm(tmp_path)
    options = ["--strict", "--noEmit", "--target", "es2022", "--module", "esnext", "--skipLibCheck"]
    options += ["--moduleResolution", "bundler"]
    for source, right in ((program, True), (program.replace("position[0]", "positions[0]"), False)):
        (tmp_path / "program.ts").write_text(source)
        done = run(TSC, *options, "program.ts", cwd=tmp_path)
        assert (done.returncode == 0) is right, done.stdout
