"""The command: from dumps to a certified model, settings files, every law, exit codes."""

import contextlib
import hashlib
import io
import json
import os
import shlex
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import warp_peri as wp
from tests.atoms.test_dumps import frame
from tests.conformance.test_breaking import SOLIDS
from tests.crystal import crystals
from tests.support import approx, each_refused, near, of_json, parametrize, shared, warned
from tests.support.materials import LAWS, solved_samples
from tests.support.nonlinear import solid
from tests.support.problems import kernel, loaded, noise, normal, smooth
from tests.support.solving import solve
from tests.support.symbols import fluctuation, noisy, waves
from warp_peri import Dataset, LPSMaterial, load
from warp_peri.cli.commands import writing
from warp_peri.cli.main import COMMANDS, MADE, WRITTEN, hashes, main, parse, parser_of, results
from warp_peri.cli.train import atom_forces
from warp_peri.crystals import fit_dispersion
from warp_peri.files.atomic import write_text
from warp_peri.points.dataset import load_dataset, save_dataset
from warp_peri.points.points import grid_places

FIT = ("--horizon", "2.5", "--degree", "3")


@shared
def data(tmp_path_factory):
    """Waves of a known model, noisy, and the noise alone."""
    clean = waves(kernel("positive", 2.5, lam=-0.1, mu=0.7), cells=4, highest=3)
    sets = {"train": noisy(clean, 0.01, 1), "test": clean, "noise": fluctuation(clean, 8, 0.01, 2)}
    path = tmp_path_factory.mktemp("command") / "data.h5"
    save_dataset(path, Dataset(sets, 3.35, 2200.0))
    return path


@shared
def fitted(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("fitted")
    assert main(["fit", str(data), "--out", str(out), *FIT, "--noise", "noise", "--json"]) == 0
    return out


def answer(capsys, *words):
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys, *words):
    """The one line that a command which cannot be done says."""
    assert main([*map(str, words)]) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


def test_a_fit_leaves_a_model_and_its_settings(fitted, data, tmp_path, capsys):
    model = LPSMaterial.load(fitted / "model.json")
    assert model.certified_on == (1.0,)
    assert model.mu == approx(0.7, rel=0.02)
    metrics = of_json(fitted / "metrics.json")
    assert metrics["loss"].startswith("output (noise is")
    assert metrics["E_u"]["test"] < 0.01
    assert "whose loads are not known" in metrics["not_evaluated"]["noise"]
    settings = [v for v in (fitted / "fit.txt").read_text().splitlines() if v[0] != "#"]
    assert sorted(settings) == sorted([str(data), "--out", str(fitted), *FIT, "--noise", "noise"])
    words = ["fit", f"@{fitted}/fit.txt", "--out", tmp_path]
    again = answer(capsys, *words)
    assert again["mu"] == approx(metrics["mu"], rel=1e-12)
    assert main([*map(str, words)]) == 0  # the same once more, in words
    printed = capsys.readouterr()
    what, sheet, good, proof, further, _, *details = printed.out.splitlines()
    assert "\r" not in printed.out + printed.err  # no bars where nobody sees them move
    assert what.startswith(f"{tmp_path}/model.json: linear peridynamic solid (LPS), horizon 2.5 Å")
    assert sheet == "moduli: of a sheet 3.35 Å thick, of 2200 kg/m³, as the data file says"
    error = 100 * again["E_u"]["test"]
    assert good.startswith(f"error of displacement: {error:.2g} % on set 'test'")
    assert proof == "proven: exactly one equilibrium for every load"
    assert any(line.startswith("  λ, μ") for line in details)
    typed = further.removeprefix("next: warp-peri ")
    assert typed.startswith(f"solve {tmp_path}/model.json {data} --set test --out ")
    assert main(shlex.split(typed)) == 0
    words += ["--degree", "2"]  # what is behind the file wins
    before = (tmp_path / "model.json").read_bytes()
    assert "model.json: is there already, not by these settings" in refused(capsys, *words)
    assert (tmp_path / "model.json").read_bytes() == before
    assert answer(capsys, *words, "--overwrite")["mu"] != again["mu"]
    assert LPSMaterial.load(tmp_path / "model.json").degree == 2


def test_certify_evaluate_solve_and_info(fitted, data, tmp_path, capsys):
    model = fitted / "model.json"
    proven = answer(capsys, "certify", model)["1 Å"]
    assert proven["holds"] is True
    assert proven["symbol_bound"] > 0.01
    assert answer(capsys, "certify", model, "--spacing", "1", "0.8").keys() == {"1 Å", "0.8 Å"}
    assert answer(capsys, "evaluate", model, data, "--set", "test")["test"]["E_u"] < 0.01
    out = tmp_path / "solved.h5"
    words = ["solve", model, data, "--out", out]
    answer(capsys, *words)
    test = load_dataset(data)["test"]
    said = (kept := tmp_path / "solved.solve.txt").read_text()
    assert str(model) in said.splitlines()
    assert results(parse(["solve", "m", "d", "--out", "a.hdf5"]))[0].name == "a.solve.hdf5.txt"
    u = solve(LPSMaterial.load(model), test, test.b, test.u)
    for more, stays in ("# mine\n", True), ("--set train\n", False), ("--set '\n", False):
        kept.write_text(said + more)
        answer(capsys, *words)
        assert kept.read_text() == said + more * stays
    assert_allclose(load_dataset(out)["test"].u, u)
    assert "not by these settings" in refused(capsys, *words, "--set", "train")
    shutil.copy(data, out)
    assert "not by these settings and inputs, or changed since" in refused(capsys, *words)
    assert answer(capsys, "info", model)["certified_on"] == [1.0]
    assert answer(capsys, "info", data)["sets"]["noise"]["samples"] == 8


def test_help_is_a_sentence_an_example_and_phrases_in_groups(capsys):
    for name in COMMANDS:
        parser = parser_of(name)
        assert parser.description.count(".") == parser.description.endswith(".") == 1
        start, program, *words = shlex.split(parser.epilog)
        assert [start, program, words[0]] == ["Example:", "warp-peri", name]
        assert parse(words).command == name
        assert " ".join(parser.format_help().split()).startswith(f"usage: warp-peri {name} ")
        for action in parser._actions:
            assert len(action.help.split()) >= 2, action.dest
            if action.nargs != 0 and not action.required and action.dest != "data":
                assert "default" in action.help or action.default == [], action.dest
    with pytest.raises(SystemExit, match="^0$"):
        main(["--version"])
    assert capsys.readouterr().out == f"warp_peri {wp.__version__}\n"


def test_where_output_goes_is_minded(fitted, data, capsys, monkeypatch):
    """A reader who has enough is no failure, a full disk one line; no letters of a terminal's."""
    read, write = os.pipe()
    os.close(read)
    full = os.open("/dev/full", os.O_WRONLY)
    no_space = "error: [Errno 28] No space left on device\n"
    for end, status, said in ((write, 0, ""), (full, 1, no_space)):
        with os.fdopen(end, "w") as output, monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", output)
            assert (main(["info", str(data)]), capsys.readouterr().err) == (status, said)
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    assert main(["info", str(fitted / "model.json")]) == 0
    assert b"\\u03bb" in raw.getvalue()


def test_sweep_chooses_and_keeps_its_settings(data, tmp_path, capsys):
    words = ["sweep", data, "--out", tmp_path, "--val", "test", "--noise", "noise", "--jobs", "1"]
    words += ["--horizons", "2.5", "--degrees", "1"]
    printed = answer(capsys, *words)
    assert printed["fits"] == 1
    assert of_json(tmp_path / "sweep.json") == printed
    assert "--degrees\n1\n" in (tmp_path / "sweep.txt").read_text()


@pytest.fixture
def sheet(tmp_path):
    """Words of coarse-grain for one load on a small body that was moved by [0.3, -0.1]."""
    x = grid_places((40, 40)) + 0.5
    force = normal(x.shape)
    np.savez(tmp_path / "f.npz", force)
    np.savetxt(tmp_path / "f.csv", force, delimiter=",")
    rest, moved = tmp_path / "r.dump", tmp_path / "l.dump"
    rest.write_text(frame(x, box=(40, 40)))
    moved.write_text(frame(x + np.array([0.3, -0.1]), box=(40, 40)))
    words = ["coarse-grain", moved, "--reference", rest, "--out", tmp_path / "own.h5"]
    words += ["--spacing", 4, "--radius", 6, "--reach", 40, "--interior", 12]
    return [*words, "--force", tmp_path / "f.npz"]


def test_dumps_become_sets_of_one_file(sheet, tmp_path, capsys):
    out, words = tmp_path / "own.h5", [*sheet, "--box", "40", "40"]
    for name, other in (("thickness", "density"), ("density", "thickness")):
        said = refused(capsys, *words, f"--{other}", "2")
        assert f"{name}: expected --{name} of the sheet" in said
    assert not out.exists()
    first = answer(capsys, *words, "--density", 2300, "--thickness", 3.1)
    assert answer(capsys, *words) == first  # the sheet is the file's
    words[words.index(tmp_path / "f.npz")] = tmp_path / "f.csv"
    answer(capsys, *words, "--set", "b.c")
    data = load_dataset(out)
    assert (data.density, data.thickness, sorted(data)) == (2300, 3.1, ["b.c", "train"])
    line = ["coarse-grain", f"@{tmp_path}/own.b%2Ec.coarse-grain.txt"]  # b.c of own, not c of own.b
    assert answer(capsys, *line)["set"] == "b.c"
    assert_array_equal(load_dataset(out)["b.c"].b, data["b.c"].b)
    save_dataset(out, data.of_sheet(density=5060.0))
    assert "set 'b.c': is there already" in refused(capsys, *line)
    save_dataset(out, data)
    assert_allclose(data["train"].u, np.broadcast_to([0.3, -0.1], (1, 441, 2)), atol=1e-9)
    assert_allclose(data["train"].b, data["b.c"].b)
    assert data.provenance["smoothing"]["radius"] == 6
    assert_allclose(data["train"].x.mean(axis=0), [20, 20])
    said = refused(capsys, *words, "--thickness", "1")
    assert "has 3.1 Å, got 1 Å; in Python wp.load(path).of_sheet(thickness=1)" in said
    out.unlink()  # a wrong sheet is corrected in its file as the command makes it anew
    answer(capsys, *words, "--density", 5060, "--thickness", 6.15)
    mended = data.of_sheet(thickness=6.15, density=5060.0)
    assert answer(capsys, "info", out)["thickness"] == 6.15
    assert_allclose(mended["train"].b, load_dataset(out)["train"].b, rtol=1e-12)


def test_a_typed_box_is_rounded_and_a_radius_fits(sheet, tmp_path, capsys, monkeypatch):
    words = [*sheet, "--thickness", "3.35", "--density", "2200", "--overwrite"]
    answer(capsys, *words, "--box", "40", "40")
    b = load_dataset(tmp_path / "own.h5")["train"].b
    answer(capsys, *words, "--box", "40.02", "39.98")
    assert_array_equal(load_dataset(tmp_path / "own.h5")["train"].b, b)
    rest = (dump := tmp_path / "l.dump").read_text()
    dump.write_text(rest.replace("\n7 1 ", "\n7 2 "))
    for more in (words, [*words, "--mass", 1]):
        assert main([*map(str, more), "--box", "40", "40"]) == 0
        assert ("atoms of several types" in capsys.readouterr().err) == (more is words)
    kept = (tmp_path / "own.train.coarse-grain.txt").read_text()
    with monkeypatch.context() as full:  # settings stay with the data that they made
        full.setattr("warp_peri.cli.train.save_dataset", lambda *_: tmp_path.read_text())
        assert main([*map(str, words), "--box", "40", "40", "--radius", "9"]) == 1
    assert "Is a directory" in capsys.readouterr().err
    assert (tmp_path / "own.train.coarse-grain.txt").read_text() == kept
    for more, said in (
        ("--box 40 40.2", "expected the header's 40 x 40 Å, got 40 x 40.2 Å"),
        ("--box 40 40 --radius 1e9", "at most 20 Å, half the smallest period, got"),
        ("--radius 1e9", "at most 39 Å, the extent of the body, got 1e+09 Å"),
        ("--set a/b --reference not-read", "'a/b' cannot be the name of a set"),
        ("--reach 100 --unloaded not-read", "nodes have no atom within the radius"),
    ):
        assert said in refused(capsys, *words, *more.split())


def test_forces_have_two_columns_as_they_are(tmp_path):
    """Three may be f_x, f_y, f_z or id, f_x, f_y: nobody can tell."""
    force = np.ones((5, 3))
    np.savez(tmp_path / "f.npz", force[:, :1])
    np.savez_compressed(tmp_path / "packed.npz", force[:, :2])
    np.savetxt(tmp_path / "f.csv", force, delimiter=",")
    each_refused(lambda name: atom_forces(tmp_path / name, 5), {
        r"f_x, f_y .* alone.*, got \[5, 1\]": "f.npz",
        r"f_x, f_y .* alone.*, got \[5, 3\]": "f.csv",
        r"numpy\.savez, not compressed": "packed.npz",
    })  # fmt: skip


def test_settings_files_hold_words_of_a_command(fitted, data, tmp_path, capsys):
    path = tmp_path / "my words"
    words = ["fit", data, "--out", tmp_path / "out", f"@{path}"]
    for text, said in (
        ("--set 'x", f"{path}: expected words of a command (No closing quotation)"),
        ("--set \udcff", f"{path}: expected words of a command ("),
        ("--overwrite", f"{path}: expected no --overwrite, which is typed"),
        ("--help", f"{path}: expected no --help, which is typed"),
        ("--horizons 3", "unrecognized arguments: --horizons"),
        ("--over", "unrecognized arguments: --over"),  # nor short for it
        ("--horizon far", "argument --horizon: invalid float value: 'far'"),
        ("--loss huber", "argument --loss: invalid choice: 'huber'"),
        ("--units nm", "argument --units: expected 2 arguments"),
        ("--set\0", "got what is no text"),
    ):
        path.write_text(text, errors="surrogateescape")
        assert said in (error := refused(capsys, *words))
        assert error.startswith(f"error: {path}: ")
    path.write_text(f"\ufeff{fitted}/model.json '{data}'  # both\n--set train\n--no-transfer\n")
    assert set(answer(capsys, "evaluate", f"@{path}", "--set", "test")) == {"test"}
    typed = "sweep d.h5 --out o --degrees 1 --degrees 2 3"
    assert parse(typed.split()).degrees == [1, 2, 3]  # in place of what is usual
    path.write_text("d.h5 --out o --degrees 1 2 --horizons 9 --jobs 2")
    given = parse(["sweep", f"@{path}", "--degrees", "3"])
    assert (given.degrees, given.horizons, given.jobs) == ([3], [9.0], 2)
    more = parse(["sweep", *given.words, "--jobs", "4"])
    assert hashes(more, path, {}) == hashes(given, path, {})
    path.write_text("\n".join(given.words))
    assert parse(["sweep", f"@{path}"]).options == given.options


WRONG = """
train | invalid choice: 'train' (choose from
fit | required: DATA.h5, --out; warp-peri fit --help
info @no-such | no-such: no such file
info nowhere.h5 | no such file
info nowhere.json | nowhere.json
fit {data} --out {new} --set none | no set 'none'
fit {data} --out {new} --noise '' | no set ''
fit {data} --out {new} --influence '' | expected gaussian, exponential
fit {data} --out {new} --influence gaussian --degree 2 | expected one of the two
fit {data} --out {new} --law tensors --degree 1 | degree: expected with --law lps, not
fit-crystal . --hold xx --trust --out {new} | trust, hold: expected with --calculator
certify {bare} | give --spacing
sweep {data} --out {new} | no set 'val'
export {bare} {data} --out {new} | certified on no spacing
solve {bare} --out {new} | required: DATA.h5
solve {bare} {data} --out {data} | is read (data)
solve {bare} {data} --out {text} | expected a .h5 file
solve {bare} {data} --out {mine} | is there already, not by these settings
solve {bare} {data} @{mine} --out {mine} | is read (files)
fit {folder}/model.json --out {folder} --overwrite | is read (data)
fit {data} --out {folder} --overwrite | is read (data)
fit-crystal x --calculator lammps:sw;{folder}/model.json --out {folder} | (calculator)
fit {data} --out {bare} | expected a folder
solve {bare} {data} --out {folder} | expected a file
sweep {data} --val test --out {new} --jobs 0 | jobs: expected
"""


def test_what_cannot_be_done_is_one_line_and_writes_nothing(data, tmp_path, capsys):
    names = {"data": "d.h5", "bare": "bare.json", "text": "thesis.txt", "mine": "mine.h5"}
    places = {key: tmp_path / name for key, name in names.items()}
    shutil.copy(data, places["data"])
    (tmp_path / "model.json").symlink_to(places["data"])
    replace(kernel("sign-changing", 2.5), trained_on=(), certified_on=()).save(places["bare"])
    for key in ("text", "mine"):
        places[key].write_text("--set train\n")
    before = {path: path.read_bytes() for path in places.values()}
    places |= {"folder": tmp_path, "new": tmp_path / "new"}
    for line in WRONG.strip().split("\n"):
        words, message = line.format(**places).split(" | ")
        assert message in refused(capsys, *shlex.split(words)), words
        assert {path: path.read_bytes() for path in before} == before
        assert not places["new"].exists() or not any(places["new"].glob("*"))
    line = "export {bare} {data} --out {new} --allow-uncertified".format(**places)
    assert main(line.split()) == 0
    assert "warning: spacing" in capsys.readouterr().err
    assert any(places["new"].glob("*.vtu"))


@parametrize("name", WRITTEN)
def test_a_folder_is_written_again_by_the_same_settings_alone(name, tmp_path, capsys, monkeypatch):
    """Same options on the same files, and nobody changed what they wrote."""
    words = ["no.h5"] * (1 + (name == "export")) + ["--out", str(tmp_path)]
    given = parse([name, *words])
    given.inputs = hashlib.sha256().hexdigest()  # nothing is there to read
    for one in WRITTEN[name].replace("*", "Yeoh").split():
        (mine := tmp_path / one).write_text("mine")
        same = hashes(given, *results(given))
        with monkeypatch.context() as other:
            other.chdir("/")  # where no.h5 is another file
            apart = hashes(given, *results(given))
        begun = [*same[:2], "# sha256 -  begun"]
        cases = (same, begun, same[:1], apart, [], [])
        for lines, more in zip(cases, 5 * [""] + ["--overwrite"]):
            (tmp_path / f"{name}.txt").write_text("\n".join([MADE, *words, *lines]))
            said = refused(capsys, name, *words, *more.split())
            assert (f"{mine}: is there already" not in said) == bool(lines in cases[:2] or more)
        (tmp_path / f"{name}.txt").write_text("\n".join([MADE, *words, *begun]))
        (other := tmp_path / "other.txt").write_text("\n".join([MADE, *same]))  # wrote it meanwhile
        assert f"{mine}: is there already" in refused(capsys, name, *words)
        other.unlink()
        given.overwrite, kept = True, results(given)[0]
        for anew, told in ((True, contextlib.nullcontext()), (False, warned("an earlier run"))):
            kept.write_text("\n".join([MADE, *words, *same]))
            with told, writing(given) as begin:
                begin()
                if anew:
                    write_text(mine, "new")
            assert (f"  {one}" in kept.read_text()) == anew
        kept.unlink()
        with contextlib.suppress(KeyboardInterrupt), writing(given) as begin:
            begin()
            raise KeyboardInterrupt
        assert not kept.exists()  # nothing was written
        mine.unlink()


def test_a_set_that_repeats_is_solved_without_a_collar(fitted, tmp_path, capsys):
    sheet, (path, out) = wp.Points.sheet((8, 8), 1.0), (tmp_path / "d.h5", tmp_path / "u.h5")
    samples = wp.Samples(sheet, *(0.01 * noise(sheet, 2, seed=seed) for seed in (1, 2)))
    save_dataset(path, Dataset({"set": samples}, 3.35, 2200.0))
    answer(capsys, "solve", fitted / "model.json", path, "--set", "set", "--out", out)
    rest = wp.solve(load(fitted / "model.json"), wp.Periodic(sheet, samples.b))
    near(load(out)["set"].u, rest.u, 1e-12)


def test_a_shape_is_fitted_by_name(data, tmp_path, capsys, monkeypatch):
    """Once more too, of the same data, where the first job was killed before all was written."""
    mine = shutil.copy(data, tmp_path / "d.h5")
    words = ["fit", mine, "--horizon", "2.5", "--loss", "residual", "--out", tmp_path]
    words += ["--influence", "gaussian"]
    other = load_dataset(data).of_sheet(density=2300.0)
    with monkeypatch.context() as patch, pytest.raises(SystemExit):  # noqa: PT012
        patch.setattr("warp_peri.cli.train._metrics", lambda _: save_dataset(mine, other) or {})
        patch.setattr("warp_peri.fitting.evaluate.write_json", lambda *_: sys.exit())
        answer(capsys, *words)
    fitted_to = load(tmp_path / "model.json").provenance["sha256"]
    assert fitted_to == hashlib.sha256(data.read_bytes()).hexdigest()
    capsys.readouterr()
    assert "not by these settings and inputs" in refused(capsys, *words)
    shutil.copy(data, mine)
    printed = answer(capsys, *words)
    model = LPSMaterial.load(tmp_path / "model.json")
    width = printed["influence"]["parameters"]["width"]
    assert printed["influence"] == model.provenance["influence"]
    assert model.influence(2.0) == approx(np.exp(-((2.0 / width) ** 2)), rel=1e-6)


@parametrize("kind", ["lps", "tensors", "third-order"])
def test_every_law_is_fitted_at_the_shell(kind, tmp_path, capsys):
    """To a crystal that no isotropic solid is, which an LPS says."""
    C = crystals.cubic_tensor(2)
    C[1, 1, 1, 1] *= 1.3
    law = fit_dispersion(crystals.dispersive(C), 1.5, 3.0, symmetry="2mm", tensor=C)
    smoothing = {"radius": 1.9 * law.spacing}
    points = crystals.lattice(2, 14, 8, law.spacing)
    fields = {"train": smooth(points.x, 8, 0, 0.25), "val": smooth(points.x, 8, 1, 0.25)}
    sets = {name: loaded(law.on(points), 1e-3 * u) for name, u in fields.items()}
    save_dataset(tmp_path / "crystal.h5", Dataset(sets, 3.35, 2200.0, {"smoothing": smoothing}))
    words = ["fit", tmp_path / "crystal.h5", "--out", tmp_path, "--horizon", law.horizon]
    words += ["--degree", 3] if kind == "lps" else ["--law", kind]
    found, kept = answer(capsys, *words), load(tmp_path / "model.json")
    names = {"lps": "LPS", "tensors": "Crystal", "third-order": "ThirdOrder"}
    assert type(kept).__name__ == names[kind] + "Material"
    assert set(found["E_u"]) == {"train", "val"}
    assert kind != "third-order" or kept.smoothing.radius == 1.9 * law.spacing
    if kind == "lps":
        assert "anisotropy: " in found["residual"]["why"]
    if kind == "tensors":
        assert found["moduli"]["C22"] == approx(law.moduli()["C22"], rel=0.02)
        assert found["E_u"]["val"] < 0.03
        assert kept.provenance["data"] == "crystal.h5"


LONG = ("third order, filtered", "third order, energy", "LPS, bond-based")


@pytest.mark.filterwarnings("ignore")
@parametrize("name", [*(name for name in LAWS if name not in LONG), "brittle"])
def test_every_command_answers_or_refuses_whatever_the_law(name, here, capsys):
    law = LAWS.get(name, LAWS["LPS"])
    wp.save("m.json", SOLIDS["brittle"](2) if name == "brittle" else law.material())
    samples = solved_samples(law.material().on(law.points(4)))
    wp.save("d.h5", wp.Dataset({"test": samples}, 3.35, 2200.0))
    for words in (
        "info m.json", "certify m.json", "evaluate m.json d.h5 --json",
        "export m.json d.h5 --out out", "solve m.json d.h5 --out out.h5",
    ):  # fmt: skip
        status, said = main(words.split()), capsys.readouterr()
        assert status in (0, 2), words
        assert bool(said.out) == (status == 0)
        if name == "brittle" and "d.h5" in words:
            assert "expected a material that is placed on nodes, got BrittleMaterial" in said.err


def test_third_order_and_crystals_are_certified_on_their_lattices(tmp_path, capsys):
    model, file = solid("energy"), tmp_path / "m.json"
    model.save(file)
    proof = answer(capsys, "certify", file)["1 Å"]["nonlinear"]
    assert proof["strain"] == approx(model.proven_strain(1.0))
    wp.save(file, law := LAWS["crystal"].material())
    said = refused(capsys, "certify", file, "--spacing", 3 * law.spacing)
    assert f"spacing: the model is for {law.spacing:g}, got" in said
