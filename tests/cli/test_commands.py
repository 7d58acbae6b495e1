"""The command: from dumps to a certified model, settings in TOML, exit codes."""

import dataclasses
import json
import os
import shlex
import shutil
import subprocess
import sys
import tomllib
from argparse import _SubParsersAction
from pathlib import Path

import meshio
import numpy as np
import pytest

from tests.micromodulus import crystals
from tests.support.plates import plate
from tests.support.problems import kernel, smooth
from tests.support.solving import solve
from tests.support.waves import fluctuation, noisy, waves
from warp_peri import Dataset, InputError, Samples, load
from warp_peri.cli.inputs import atom_forces
from warp_peri.cli.main import _parser, main
from warp_peri.materials.lps import Model
from warp_peri.micromodulus import fit_symbol
from warp_peri.points.dataset import load_dataset, save_dataset

ROOT = Path(__file__).parent.parent.parent
HORIZON = 2.5


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Waves of a known model, noisy, and the noise alone."""
    model = kernel("positive", HORIZON, lam=-0.1, mu=0.7)
    clean = waves(model, cells=4, highest=3)
    sets = {"train": noisy(clean, 0.01, 1), "test": clean, "noise": fluctuation(clean, 8, 0.01, 2)}
    path = tmp_path_factory.mktemp("command") / "data.h5"
    save_dataset(path, Dataset(sets, 3.35, 2200.0))
    return path


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("trained")
    words = ["train", str(data), "--out", str(out), "--horizon", "2.5", "--degree", "3"]
    assert main([*words, "--noise", "noise", "--json"]) == 0
    return out


def answer(capsys, *words):
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_train_leaves_a_certified_model_and_its_settings(trained, data, capsys):
    model = Model.load(trained / "model.json")
    assert model.certified_on == (1.0,)
    assert model.mu == pytest.approx(0.7, rel=0.02)
    metrics = json.loads((trained / "metrics.json").read_text())
    assert metrics["loss"].startswith("output (noise is")
    assert metrics["E_u"]["test"] < 0.01
    assert "whose loads are not known" in metrics["not_evaluated"]["noise"]
    settings = tomllib.loads((trained / "train.toml").read_text())["train"]
    assert settings["horizon"] == 2.5
    assert settings["data"] == str(data)
    assert "config" not in settings


def test_a_run_is_repeated_from_its_settings(trained, tmp_path, capsys):
    again = answer(capsys, "train", "--config", trained / "train.toml", "--out", tmp_path)
    first = json.loads((trained / "metrics.json").read_text())["mu"]
    assert again["mu"] == pytest.approx(first, rel=1e-12)
    words = ["train", "--config", trained / "train.toml", "--out", tmp_path]
    answer(capsys, *words)  # the same once more
    words += ["--degree", "2"]  # the line goes before the file
    before = (tmp_path / "model.json").read_bytes()
    assert main([str(word) for word in words]) == 2
    assert "model.json: is there already, by other settings" in capsys.readouterr().err
    assert (tmp_path / "model.json").read_bytes() == before
    other = answer(capsys, *words, "--overwrite")
    assert Model.load(tmp_path / "model.json").degree == 2
    assert other["mu"] != again["mu"]


def test_certify_evaluate_solve_and_info(trained, data, tmp_path, capsys):
    model_file = trained / "model.json"
    proven = answer(capsys, "certify", model_file)["1 Å"]
    assert proven["holds"] is True
    assert proven["symbol_bound"] > 0.01
    assert answer(capsys, "certify", model_file, "--spacing", "1", "0.8").keys() == {"1 Å", "0.8 Å"}
    errors = answer(capsys, "evaluate", model_file, data, "--set", "test")
    out = tmp_path / "solved.h5"
    answer(capsys, "solve", model_file, data, "--out", out)
    test = load_dataset(data)["test"]
    settings = tomllib.loads((tmp_path / "solved.solve.toml").read_text())["solve"]
    assert settings["set"] == "test"
    u = solve(Model.load(model_file), test, test.b, test.u)
    np.testing.assert_allclose(load_dataset(out)["test"].u, u)
    assert answer(capsys, "info", model_file)["certified_on"] == [1.0]
    sets = answer(capsys, "info", data)["sets"]
    assert sets["noise"]["samples"] == 8
    assert errors["test"]["E_u"] < 0.01


COMMAND_PARSERS = next(
    action for action in _parser()._actions if isinstance(action, _SubParsersAction)
).choices


@pytest.mark.parametrize("name", COMMAND_PARSERS)
def test_help_is_a_sentence_an_example_and_phrases_in_groups(name):
    parser = COMMAND_PARSERS[name]
    assert parser.description.endswith(".")
    assert parser.description.count(".") == 1
    assert len(parser.description.split()) <= 25
    start, program, command, *words = shlex.split(parser.epilog)
    assert [start, program, command] == ["Example:", "warp-peri", name]
    assert _parser().parse_args([command, *words]).command == name
    ours = [group for group in parser._action_groups if group.title not in ("options", None)]
    titles = [group.title for group in ours if group._group_actions]
    assert titles[: len({*titles} & {"input", "model", "output"})] == [
        title for title in ("input", "model", "output") if title in titles
    ]
    shown = " ".join(parser.format_help().split())
    assert shown.startswith(f"usage: warp-peri {name} ")
    for action in [action for group in ours for action in group._group_actions]:
        assert len(action.help.split()) >= 2, action.dest
        if action.option_strings and action.nargs != 0 and not action.required:
            said = " ".join(parser._get_formatter()._expand_help(action).split())
            known = "default" in said or action.default == []
            assert known, f"{action.dest}: nobody says what is taken without it"


def test_training_says_what_there_is_how_good_and_what_next(data, tmp_path, capsys):
    words = ["train", str(data), "--out", str(tmp_path), "--horizon", "2.5", "--degree", "3"]
    assert main([*words, "--loss", "residual"]) == 0
    what, sheet, good, proof, further, line, *details = capsys.readouterr().out.splitlines()
    error = json.loads((tmp_path / "metrics.json").read_text())["E_u"]["test"]
    assert what.startswith(f"{tmp_path}/model.json: linear peridynamic solid (LPS), horizon 2.5 Å")
    assert sheet == "moduli: of a sheet 3.35 Å thick, of 2200 kg/m³, as the data file says"
    assert good.startswith(f"error of displacement: {100 * error:.2g} % on set 'test'")
    assert proof == "proven: exactly one equilibrium for every load"
    assert set(line) == {"-"}
    assert any(line.startswith("mu: ") for line in details)
    typed = further.removeprefix("next: warp-peri ")
    assert typed.startswith(f"solve {tmp_path}/model.json {data} --set test --out ")
    assert main(shlex.split(typed)) == 0
    settings = tomllib.loads((tmp_path / "train.toml").read_text())["train"]
    assert not {"first", "told"} & {*settings}


def test_people_read_lines(trained, data, capsys):
    assert main(["info", str(trained / "model.json")]) == 0
    text = capsys.readouterr().out
    assert "certified on" in text
    assert main(["evaluate", str(trained / "model.json"), str(data), "--set", "test"]) == 0
    assert "E_u [%]" in capsys.readouterr().out


def info_to(output, data):
    """A command whose output goes to an open file."""
    command = [sys.executable, "-m", "warp_peri", "info", data]
    return subprocess.run(
        command, stdout=output, stderr=subprocess.PIPE, text=True, cwd=ROOT, check=False
    )


def test_a_reader_who_has_enough_is_no_failure(data):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as output:
        process = info_to(output, data)
    assert (process.returncode, process.stderr) == (0, "")


def test_a_full_disk_behind_the_output_is_one_line(data):
    with open("/dev/full", "w") as output:
        process = info_to(output, data)
    assert process.returncode == 1
    assert process.stderr == "error: [Errno 28] No space left on device\n"


def test_a_terminal_without_greek_and_a_pipe_are_spoken_to(trained, data, tmp_path):
    """No letters that it does not have, and no bars where nobody sees them move."""
    words = ["train", data, "--horizon", "2.5", "--degree", "3", "--out", tmp_path / "m"]
    words += ["--noise", "noise", "--method", "constrained"]
    for each in (words, ["info", tmp_path / "m" / "model.json"]):
        done = subprocess.run(
            [sys.executable, "-m", "warp_peri", *map(str, each)],
            env=os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONPATH": str(ROOT)},
            capture_output=True, text=True, cwd=tmp_path, check=True,
        )  # fmt: skip
        assert "\r" not in done.stdout + done.stderr
    assert "\\u03bb" in done.stdout


def test_sweep_chooses_and_keeps_its_settings(data, tmp_path, capsys):
    words = ["sweep", data, "--out", tmp_path, "--val", "test", "--noise", "noise", "--jobs", "1"]
    printed = answer(capsys, *words, "--horizons", "2.5", "--degrees", "0", "1")
    assert printed["fits"] == 2
    assert json.loads((tmp_path / "sweep.json").read_text()) == printed
    settings = tomllib.loads((tmp_path / "sweep.toml").read_text())["sweep"]
    assert settings["degrees"] == [0, 1]


def dump(path, positions):
    lines = ["ITEM: TIMESTEP", "0", "ITEM: NUMBER OF ATOMS", f"{len(positions)}"]
    lines += ["ITEM: BOX BOUNDS pp pp pp", "0 40", "0 40", "-5 5", "ITEM: ATOMS id type x y z"]
    lines += [f"{i} 1 {x:.12f} {y:.12f} 0" for i, (x, y) in enumerate(positions, start=1)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_dumps_become_sets_of_one_file(tmp_path, capsys):
    grid = np.arange(0.5, 40, 1.0)
    reference = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    moved = np.array([0.3, -0.1])
    force = np.random.default_rng(0).normal(size=reference.shape)
    np.savez(tmp_path / "f.npz", force)
    np.savetxt(tmp_path / "f.csv", force, delimiter=",")
    rest, loaded = (
        dump(tmp_path / "r.dump", reference),
        dump(tmp_path / "l.dump", reference + moved),
    )
    out = tmp_path / "own.h5"
    words = ["coarse-grain", loaded, "--reference", rest, "--out", out, "--spacing", "4"]
    words += ["--radius", "6", "--reach", "40", "--interior", "12", "--box", "40", "40"]
    words += ["--density", "2300"]
    assert main([*map(str, words), "--force", str(tmp_path / "f.npz")]) == 2
    assert "expected --thickness of the sheet [Å], got none" in capsys.readouterr().err
    words += ["--thickness", "3.1"]
    first = answer(capsys, *words, "--force", tmp_path / "f.npz")
    answer(capsys, *words, "--force", tmp_path / "f.csv", "--set", "val")
    data = load_dataset(out)
    assert sorted(data) == ["train", "val"]
    settings = tomllib.loads((tmp_path / "own.val.coarse-grain.toml").read_text())["coarse-grain"]
    assert settings["box"] == [40.0, 40.0]
    before = data["val"].b
    line = ["coarse-grain", "--config", tmp_path / "own.val.coarse-grain.toml"]
    assert answer(capsys, *line)["set"] == "val"
    np.testing.assert_array_equal(load_dataset(out)["val"].b, before)
    assert first["nodes"] == 21 * 21
    np.testing.assert_allclose(data["train"].u, np.broadcast_to(moved, (1, 441, 2)), atol=1e-9)
    np.testing.assert_allclose(data["train"].b, data["val"].b)
    middle = data["train"].x.mean(axis=0)
    np.testing.assert_allclose(middle, [20, 20])
    assert main([*map(str, words), "--force", str(tmp_path / "f.npz"), "--thickness", "1"]) == 2
    assert (
        "has 3.1 Å, got 1 Å; in Python wp.load(path).of_sheet(thickness=1)"
        in capsys.readouterr().err
    )
    np.savez(tmp_path / "f.npz", force[:-1])
    assert main([*map(str, words), "--force", str(tmp_path / "f.npz")]) == 2
    assert "expected shape [1600, 2], got [1599, 2]" in capsys.readouterr().err


SHEET = ("--thickness", "3.35", "--density", "2200")


@pytest.fixture
def crystal(tmp_path):
    """Words of coarse-grain for one load on a small periodic body."""
    grid = np.arange(0.5, 40, 1.0)
    x = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    np.savez(tmp_path / "f.npz", np.ones_like(x))
    rest, load = dump(tmp_path / "r.dump", x), dump(tmp_path / "l.dump", x + 0.1)
    words = ["coarse-grain", load, "--reference", rest, "--force", tmp_path / "f.npz"]
    words += ["--out", tmp_path / "own.h5", "--spacing", 4, "--reach", 16, "--interior", 8]
    return [str(word) for word in words]


def test_the_sheet_is_the_file_s(crystal, tmp_path, capsys):
    words = [*crystal, "--box", "40", "40", "--radius", "6"]
    out = tmp_path / "own.h5"
    assert main([*words, "--density", "3000", "--thickness", "2"]) == 0
    assert main([*words, "--set", "val"]) == 0
    data = load_dataset(out)
    assert (data.density, data.thickness, sorted(data)) == (3000, 2, ["train", "val"])
    np.testing.assert_array_equal(data["train"].b, data["val"].b)
    assert main([*words, "--density", "2200"]) == 2
    assert "has 3000 kg/m³, got 2200 kg/m³" in capsys.readouterr().err
    out.unlink()
    for name, other in (("thickness", "density"), ("density", "thickness")):
        assert main([*words, f"--{other}", "2"]) == 2
        assert f"{name}: expected --{name} of the sheet" in capsys.readouterr().err
    assert not out.exists()


def test_a_sheet_is_corrected_in_its_file(crystal, tmp_path, capsys):
    """As the command makes it anew: loads go as one over the thickness; what was typed is told."""
    words = [*crystal, "--box", "40", "40", "--radius", "6"]
    out = tmp_path / "own.h5"
    assert main([*words, "--density", "3000", "--thickness", "2"]) == 0
    wrong = load_dataset(out)
    out.unlink()
    assert main([*words, "--density", "5060", "--thickness", "6.15"]) == 0
    made, mended = load_dataset(out), wrong.of_sheet(thickness=6.15, density=5060.0)
    np.testing.assert_allclose(mended["train"].b, made["train"].b, rtol=1e-12)
    np.testing.assert_array_equal(mended["train"].u, made["train"].u)
    assert (mended.thickness, mended.density) == (made.thickness, made.density)
    save_dataset(out, mended)
    capsys.readouterr()
    assert main(["info", str(out)]) == 0
    said = capsys.readouterr().out
    assert "thickness: 6.15 Å\n" in said
    assert "density: 5060 kg/m³\n" in said
    for wrong_thickness in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="thickness: expected"):
            mended.of_sheet(thickness=wrong_thickness)


def test_a_typed_box_is_rounded(crystal, tmp_path, capsys):
    out, words = tmp_path / "own.h5", [*crystal, *SHEET, "--radius", "6", "--box"]
    assert main([*words, "40", "40"]) == 0
    b = load_dataset(out)["train"].b
    assert main([*words, "40.02", "39.98"]) == 0
    np.testing.assert_array_equal(load_dataset(out)["train"].b, b)
    assert main([*words, "40", "40.2"]) == 2
    assert "expected the header's 40 x 40 Å, got 40 x 40.2 Å" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("box", "message"),
    [
        (["--box", "40", "40"], "at most 20 Å, half the smallest period, got 1e+09 Å"),
        ([], "at most 39 Å, the extent of the body, got 1e+09 Å"),
    ],
)
def test_a_radius_fits_the_body(crystal, box, message, capsys):
    assert main([*crystal, *SHEET, *box, "--radius", "1e9"]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("columns", [1, 3])
@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_forces_have_two_columns(columns, kind, tmp_path):
    """Three may be f_x, f_y, f_z or id, f_x, f_y: nobody can tell."""
    path, force = tmp_path / f"f.{kind}", np.ones((5, columns))
    np.savez(path, force) if kind == "npz" else np.savetxt(path, force, delimiter=",")
    with pytest.raises(InputError, match=rf"got \[5, {columns}\]; the columns are f_x, f_y"):
        atom_forces(path, 5)


def test_compressed_forces_are_refused_with_the_way_out(tmp_path):
    np.savez_compressed(tmp_path / "f.npz", np.ones((5, 2)))
    with pytest.raises(InputError, match=r"numpy\.savez, not compressed"):
        atom_forces(tmp_path / "f.npz", 5)


BAD_CONFIG = {
    "not TOML": ("horizon = ", "expected a TOML file"),
    "no table": ("[solve]\n", "expected a table [train]"),
    "unknown": ("[train]\nhorizons = 3\n", "no option 'horizons'"),
    "a list": ("[train]\nhorizon = [3, 4]\n", "not what this option takes"),
    "not a number": ('[train]\nhorizon = "far"\n', "horizon"),
    "not a choice": ('[train]\nloss = "huber"\n', "expected of auto"),
    "not yes or no": ("[train]\nnormalise = 3\n", "not what this option takes"),
}


@pytest.mark.parametrize(("text", "words"), BAD_CONFIG.values(), ids=BAD_CONFIG)
def test_settings_that_make_no_sense_are_refused(text, words, data, tmp_path, capsys):
    path = tmp_path / "run.toml"
    path.write_text(text)
    line = ["train", str(data), "--out", str(tmp_path / "out"), "--config", str(path)]
    assert main(line) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["info", "nowhere.h5"], 2, "no such data set"),
        (["info", "nowhere.json"], 2, "nowhere.json"),
        (["train", "{data}", "--out", "{tmp}/o", "--set", "none"], 2, "no set 'none'"),
        (["train", "{data}", "--out", "{tmp}/o", "--noise", "none"], 2, "no set 'none'"),
        (["certify", "{bare}"], 2, "give --spacing"),
        (["sweep", "{data}", "--out", "{tmp}/o"], 2, "no set 'val'"),
    ],
)
def test_errors_are_one_line(words, status, message, data, tmp_path, capsys):
    bare = tmp_path / "bare.json"
    dataclasses.replace(kernel("1/r", HORIZON), trained_on=(), certified_on=()).save(bare)
    places = {"data": data, "tmp": tmp_path, "bare": bare}
    assert main([word.format(**places) for word in words]) == status
    err = capsys.readouterr().err
    assert message in err
    assert err.startswith("error: ")
    assert err.count("\n") == 1


def test_a_shape_is_trained_by_name(data, tmp_path, capsys):
    words = ["train", data, "--out", tmp_path, "--horizon", "2.5", "--influence", "gaussian"]
    printed = answer(capsys, *words, "--loss", "residual")
    model = Model.load(tmp_path / "model.json")
    width = printed["influence"]["parameters"]["width"]
    assert printed["influence"] == model.provenance["influence"]
    assert model.influence(2.0) == pytest.approx(np.exp(-((2.0 / width) ** 2)), rel=1e-6)
    settings = tomllib.loads((tmp_path / "train.toml").read_text())["train"]
    assert settings["influence"] == "gaussian"
    again = answer(capsys, "train", "--config", tmp_path / "train.toml")
    assert again["mu"] == pytest.approx(printed["mu"], rel=1e-12)


def test_a_table_is_trained_from_a_file(data, tmp_path, capsys):
    K = tmp_path / "K.csv"
    K.write_text("# r, K\n0.5, 1.0\n2.5, 0.2\n")
    words = ["train", data, "--out", tmp_path / "run", "--horizon", "2.5", "--influence", K]
    assert answer(capsys, *words, "--loss", "residual")["influence"]["function"] == "tabulated"
    model = Model.load(tmp_path / "run" / "model.json")
    np.testing.assert_allclose(model.influence([1.0, 2.0]), [0.8, 0.4], rtol=1e-7)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("1.0, 2.0, 3.0\n", "expected two columns r, K with a comma, or their names, got"),
        ("x, K\n1.0, 2.0\n", "could not convert string 'x'"),
        ("", "expected two columns r, K"),
        ("0.5, 1.0\n2.0, 1.0\n", "expected K out to the longest bond, 2.23607 Å, got it to 2 Å"),
        ("2.0, 1.0\n1.0, 1.0\n", "expected finite K at rising finite r"),
        (None, "K.csv: no such file"),
    ],
)
def test_tables_that_cannot_be_used(content, message, data, tmp_path, capsys):
    K = tmp_path / "K.csv"
    if content is not None:
        K.write_text(content)
    words = ["train", str(data), "--out", str(tmp_path / "run"), "--influence", str(K)]
    assert main([*words, "--horizon", "2.5"]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_no_shape_of_that_name(data, tmp_path, capsys):
    words = ["train", str(data), "--out", str(tmp_path / "run"), "--influence", "gausian"]
    assert main(words) == 2
    assert "expected gaussian, exponential, conical or a .csv file" in capsys.readouterr().err


def test_zeta_is_kept(data, tmp_path, capsys):
    words = ["train", data, "--out", tmp_path, "--horizon", "2.5", "--degree", "3"]
    answer(capsys, *words, "--loss", "residual", "--zeta", "0.3")
    figures = Model.load(tmp_path / "model.json").certificate["1"]
    assert figures["symbol_bound"] > 0.29


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["solve", "{model}", "{data}", "--out", "{data}"], "is read (data)"),
        (["solve", "{model}", "{data}", "--out", "{model}"], "is read (model)"),
        (["export", "{model}", "{data}", "--out", "{model}"], "is read (model)"),
        (["export", "{model}", "{data}", "--out", "{data}"], "is read (data)"),
        (["train", "{data}", "--out", "{other}"], "expected a folder"),
        (["sweep", "{data}", "--val", "test", "--out", "{other}"], "expected a folder"),
        (["solve", "{model}", "{data}", "--out", "{folder}"], "expected a file"),
        (["sweep", "{data}", "--val", "test", "--out", "{new}", "--jobs", "0"], "jobs: expected"),
    ],
)
def test_nothing_is_written_over_what_is_read(words, message, trained, data, tmp_path, capsys):
    places = {"model": tmp_path / "m.json", "data": tmp_path / "d.h5", "other": tmp_path / "o.txt"}
    shutil.copy(trained / "model.json", places["model"])
    shutil.copy(data, places["data"])
    places["other"].write_text("kept")
    before = {path: path.read_bytes() for path in places.values()}
    places |= {"folder": tmp_path, "new": tmp_path / "new"}
    assert main([word.format(**places) for word in words]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert {path: path.read_bytes() for path in before} == before


def test_fields_are_exported_on_certified_lattices(data, tmp_path, capsys):
    model = tmp_path / "bare.json"
    dataclasses.replace(kernel("sign-changing", HORIZON), certified_on=()).save(model)
    words = ["export", str(model), str(data), "--out", str(tmp_path / "fields")]
    assert main(words) == 2
    assert "certified on no spacing" in capsys.readouterr().err
    assert not (tmp_path / "fields").exists()
    assert main([*words, "--allow-uncertified"]) == 0
    assert "warning: spacing" in capsys.readouterr().err


def test_sets_on_the_line_take_the_place_of_those_in_the_file(trained, data, tmp_path, capsys):
    settings = tmp_path / "e.toml"
    settings.write_text('[evaluate]\nsets = ["train"]\n')
    words = ["evaluate", trained / "model.json", data, "--config", settings]
    assert set(answer(capsys, *words)) == {"train"}
    assert set(answer(capsys, *words, "--set", "test")) == {"test"}
    assert set(answer(capsys, *words, "--set=test", "--set", "train")) == {"test", "train"}


def crystal_data(folder):
    """Waves of a crystal that no isotropic solid is, the moduli of whose fits the data deny."""
    C = crystals.cubic_tensor(2)
    C[1, 1, 1, 1] *= 1.3
    law = fit_symbol(crystals.dispersive(C), 1.5, 3.0, symmetry="2mm", tensor=C)
    points = crystals.lattice(2, 20, 8, law.spacing)
    sets = {name: crystal_waves(law, points, 16, seed) for name, seed in (("train", 0), ("val", 1))}
    save_dataset(folder / "crystal.h5", Dataset(sets, 3.35, 2200.0))
    return law, folder / "crystal.h5"


def crystal_waves(law, points, count, seed):
    u = 1e-3 * smooth(points.x, count, seed, wave_number=0.25)
    b = np.zeros_like(u)
    b[:, points.interior] = law.on(points)(u)
    return Samples(points, u, b)


def test_moduli_that_the_data_deny_are_told_beside_those_that_they_have(tmp_path, capsys):
    law, path = crystal_data(tmp_path)
    words = ["train", path, "--out", tmp_path / "lps", "--horizon", law.horizon, "--degree", 3]
    assert main([*map(str, words)]) == 0
    printed = capsys.readouterr()
    assert "--law tensors, Micromodulus(…), has them" in printed.err
    told = json.loads((tmp_path / "lps" / "metrics.json").read_text())
    for name, value in law.moduli().items():
        assert told["moduli of a crystal model"][name] == pytest.approx(
            value, abs=0.006
        )  # 3.5 % of C11
    assert max(abs(told["moduli"][n] / law.moduli()[n] - 1) for n in ("C11", "C12", "C44")) > 0.05
    assert "moduli of a crystal model" in printed.out


@pytest.mark.parametrize("kind", ["tensors", "third-order"])
def test_every_law_is_trained_at_the_shell(kind, tmp_path, capsys):
    law, path = crystal_data(tmp_path)
    words = ["train", path, "--law", kind, "--out", tmp_path / "out"]
    found = answer(capsys, *words, "--horizon", law.horizon)
    kept = load(tmp_path / "out" / "model.json")
    if kind != "third-order":
        assert found["moduli"]["C22"] == pytest.approx(law.moduli()["C22"], rel=0.02)
    assert type(kept).__name__ == {"tensors": "Crystal", "third-order": "ThirdOrderCrystal"}[kind]
    assert set(found["E_u"]) == {"train", "val"}
    if kind == "tensors":
        assert found["E_u"]["val"] < 0.03
        assert kept.provenance["data"] == "crystal.h5"
    assert main([*map(str, words), "--influence", "gaussian", "--out", str(tmp_path / "b")]) == 2
    assert f"--influence: not of --law {kind}" in capsys.readouterr().err


def test_an_interrupt_says_whether_anything_is_kept(data, tmp_path, capsys, monkeypatch):
    def stops(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("warp_peri.learning.laws.learn", stops)
    words = ["train", str(data), "--out", str(tmp_path / "new"), "--horizon", "2.5"]
    assert main(words) == 130
    assert "interrupted; nothing is kept yet" in capsys.readouterr().err


def test_info_of_a_mesh(tmp_path, capsys):
    mesh = plate(3.0, 12.0, 6, 24)
    cells = [("triangle", mesh.triangles)]
    made = meshio.Mesh(np.pad(mesh.x, ((0, 0), (0, 1))), cells)
    made.write(tmp_path / "plate.msh", file_format="gmsh")
    told = answer(capsys, "info", tmp_path / "plate.msh")
    assert told["format"] == "mesh"
    assert (told["corners"], told["triangles"]) == (len(mesh.x), len(mesh.triangles))
    assert told["box"] == np.stack([mesh.x.min(axis=0), mesh.x.max(axis=0)], axis=1).tolist()
    assert sum(told["parts"].values()) == len(mesh.edges)
