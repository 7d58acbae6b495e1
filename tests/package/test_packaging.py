"""What a user gets: the sdist, the wheel built from it, and the wheel in an environment of its own.

Nothing is fetched: setuptools builds here, and what the wheel depends on is lent by the environment
that runs the tests.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
SOURCES = ("warp_peri", "kernels", "tests", "pyproject.toml", "MANIFEST.in", "README.md", "LICENSE")
EXTRAS = ("CHANGELOG.md", "CITATION.cff", "constraints.txt")


def run(command, folder, **options):
    """Standard output of a command outside the checkout, which is not on its path."""
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    options = {"capture_output": True, "text": True, "check": False} | options
    finished = subprocess.run([*map(str, command)], cwd=folder, env=clean, **options)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def built(what, source, out):
    """The file that setuptools builds of a source tree: "sdist" or "wheel"."""
    out.mkdir()
    code = f"from setuptools import build_meta; build_meta.build_{what}({str(out)!r})"
    run([sys.executable, "-c", code], source)
    (file,) = out.iterdir()
    return file


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    """Built from a copy, so that nothing is left in the checkout or taken from an older build."""
    tree = tmp_path_factory.mktemp("tree") / "source"
    tree.mkdir()
    skipped = shutil.ignore_patterns("__pycache__")
    for name in (*SOURCES, *EXTRAS):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, tree / name, symlinks=True, ignore=skipped)
        else:
            shutil.copy(ROOT / name, tree / name)
    for name in ("data", "runs"):  # as they lie beside the sources when a user builds
        (tree / name).mkdir()
        (tree / name / "large.h5").write_bytes(b"0")
    return built("sdist", tree, tree.parent / "out")


@pytest.fixture(scope="module")
def wheel(sdist, tmp_path_factory):
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as file:
        file.extractall(folder, filter="data")
    (source,) = folder.iterdir()
    return built("wheel", source, folder / "out")


def package_files():
    """Every file of the package as a user sees it, below warp_peri/."""
    walked = os.walk(ROOT / "warp_peri", followlinks=True)  # kernels/ is a link
    files = [
        Path(place) / name for place, _, names in walked for name in names if name.endswith(".py")
    ]
    files += [ROOT / "warp_peri/py.typed"]
    return {str(file.relative_to(ROOT)) for file in files}


def test_the_sdist_holds_what_builds_and_nothing_else(sdist):
    with tarfile.open(sdist) as file:
        members = file.getmembers()
    assert all(member.isfile() or member.isdir() for member in members)  # no link
    names = {member.name.partition("/")[2] for member in members if member.isfile()}
    beside = {"pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "PKG-INFO", "setup.cfg"}
    names = {name for name in names if not name.startswith("warp_peri.egg-info/")}
    assert names == package_files() | beside | set(EXTRAS)


def test_the_wheel_holds_the_package_alone(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = {name for name in file.namelist() if ".dist-info/" not in name}
        assert names == package_files()
        for name in names:
            assert file.read(name) == (ROOT / name).read_bytes(), name
        (license_file,) = (name for name in file.namelist() if name.endswith("/LICENSE"))
        assert file.read(license_file) == (ROOT / "LICENSE").read_bytes()
    assert wheel.name.endswith("-py3-none-any.whl")


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder of the commands of an environment that has the wheel and borrows all else."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=True)
    commands = folder / "bin"
    options = ("--quiet", "--no-deps", "--no-index")
    run([commands / "python", "-m", "pip", "install", *options, wheel], folder)
    own = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (own / "lent.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return commands


@pytest.mark.slow
def test_the_installed_package_works(installed, tmp_path):
    script = shutil.copy(ROOT / "tests/package/typed_use.py", tmp_path)
    run([installed / "python", script, tmp_path], tmp_path)
    command, data = installed / "warp-peri", "data.h5"
    settings = ("--horizon", "2.5", "--degree", "1", "--out", "run")
    run([command, "train", data, *settings], tmp_path)
    model = tmp_path / "run/model.json"
    assert "exactly one solution" in run([command, "certify", model], tmp_path)
    assert "E_u [%]" in run([command, "evaluate", model, data], tmp_path)
    run([command, "solve", model, data, "--out", "solved.h5"], tmp_path)
    run([command, "export", model, data, "--out", "fields"], tmp_path)
    assert len(list(tmp_path.glob("fields/*.vtu"))) == 8
