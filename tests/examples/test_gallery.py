"""The gallery: every figure is there, and the command under it can be given."""

import importlib
import re
import shlex
import shutil
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import meshio
import numpy as np
import pytest
from PIL import Image

from examples.studies import gallery
from tests.support.problems import kernel, lattice, manufactured
from warp_peri.cli import commands as subcommands
from warp_peri.cli.main import main
from warp_peri.errors import InputError
from warp_peri.export import write_fields

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"


def figures():
    """Heading, picture, commands of each."""
    return [(figure.title, figure.path, figure.commands) for figure in gallery.FIGURES]


def test_the_page_is_what_the_script_writes():
    assert (DOCS / "gallery.md").read_text(encoding="utf-8") == gallery.cards()


def test_nine_cards_of_twelve_words_lead_to_pages_of_the_menu():
    text, menu = gallery.cards(), (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    found = re.findall(r"\[!\[[^]]+\]\(([^)]+)\)\{ width=400 \}\]\(([^)]+)\)<br>([^|]+) \|", text)
    assert len(found) == len({page for _, page, _ in found}) == 9
    for picture, page, words in found:
        assert (DOCS / picture).stat().st_size <= gallery.LARGEST
        assert f": {page}\n" in menu, page
        assert 4 <= len(words.split()) <= 12, words


@pytest.mark.parametrize(("title", "picture", "commands"), figures())
def test_every_figure_is_there_and_its_commands_can_be_given(
    title, picture, commands, monkeypatch, capsys
):
    path = DOCS / picture
    assert path.stat().st_size <= gallery.LARGEST
    with Image.open(path) as image:
        image.load()
        assert min(image.size) > 300
    assert commands
    parsed = []
    for name in [name for name in vars(subcommands) if name.startswith("run_")]:
        monkeypatch.setattr(subcommands, name, lambda given: parsed.append(given) or {})
    for command in commands:
        command = command.replace("\\\n", "")
        program, *words = shlex.split(command.removeprefix("mpiexec -n 4 "))
        if program == "warp-peri":
            assert main(words) == 0  # SystemExit for a command or option that is not
            assert parsed.pop().command == words[0]
        else:
            assert program == "python"
            assert (ROOT / words[0]).is_file()
            script = importlib.import_module(words[0].removesuffix(".py").replace("/", "."))
            if not hasattr(script, "main"):  # a script without options
                assert not words[1:]
                continue
            monkeypatch.setattr(sys, "argv", [words[0], "--help"])
            with pytest.raises(SystemExit) as stopped:
                script.main()
            assert stopped.value.code == 0
            known = re.findall(r"(?<![\w-])--?[a-z][\w-]*", capsys.readouterr().out)
            assert {word for word in words if word.startswith("-")} <= set(known)


def test_nothing_lies_in_the_folder_that_the_page_does_not_show():
    shown = {DOCS / picture for _, picture, _ in figures()}
    assert set((DOCS / "gallery").iterdir()) <= shown


def test_a_missing_figure_is_named_with_its_command(tmp_path):
    given = ["--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "docs")]
    said = "disks.png: no such file; it is made by: python examples/train_graphene.py"
    with pytest.raises(InputError, match=re.escape(said)):
        gallery.main(given)
    assert not any(tmp_path.iterdir())


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    model = kernel("positive", 2.5)
    points = manufactured(model, lattice(6, 2.5), 1)
    return write_fields(tmp_path_factory.mktemp("fields"), model, points, points.u)[0]


def test_the_stress_drawn_is_the_stress_of_the_file(exported):
    data = meshio.read(exported).point_data
    figure = gallery.stress(exported)
    for ax, column in zip(figure.axes, (0, 1, 3)):
        collar, faces = ax.collections
        assert (len(faces.get_paths()), len(collar.get_paths())) == (5**2, 15**2 - 5**2)
        inside = data["interior"] == 1
        corners = data["stress"][inside, column].reshape(6, 6)
        means = (corners[1:, 1:] + corners[:-1, 1:] + corners[1:, :-1] + corners[:-1, :-1]) / 4
        np.testing.assert_allclose(np.sort(faces.get_array()), np.sort(1e3 * means.ravel()))
    plt.close(figure)


def test_collecting_into_an_empty_folder(exported, tmp_path):
    for figure in gallery.FIGURES:
        if figure.source:
            source = tmp_path / "runs" / figure.source
            source.parent.mkdir(parents=True, exist_ok=True)
            large = source.name == "disks.png"
            if source.suffix == ".vtu":
                shutil.copy(exported, source)
            else:
                noise = np.random.default_rng(0).integers(0, 255, (300, 1500 if large else 60, 3))
                Image.fromarray(noise.astype(np.uint8)).save(source)
        else:
            (tmp_path / figure.path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(DOCS / figure.path, tmp_path / figure.path)
    given = ["--runs", str(tmp_path / "runs"), "--out", str(tmp_path)]
    assert gallery.main(given) == 0
    assert (tmp_path / "gallery.md").read_text(encoding="utf-8") == gallery.cards()
    assert all((tmp_path / figure.path).exists() for figure in gallery.FIGURES)
    small = tmp_path / "gallery" / "loss.png"
    assert small.read_bytes() == (tmp_path / "runs" / "graphene_0K" / "loss.png").read_bytes()
    with Image.open(tmp_path / "gallery" / "disks.png") as image:
        assert image.size == (gallery.WIDTH, 200)
