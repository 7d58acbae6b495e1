"""Fifteen failures: each occurs, says what its page prints, and is smaller with the remedy."""

import json
import re
from pathlib import Path

import pytest

from examples import stability
from examples.prose import readable, said_by

ROOT = Path(__file__).parent.parent.parent
RECORD = json.loads((ROOT / "docs/record/stability.json").read_text(encoding="utf-8"))["cases"]
PAGE = (ROOT / "docs/explanation/where_it_fails.md").read_text(encoding="utf-8")
SECTIONS = {
    heading.replace("-", "_"): text
    for heading, text in re.findall(r"^### [^{]+\{#([\w-]+)\}\n(.*?)(?=^##|\Z)", PAGE, re.M | re.S)
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("case", stability.CASES, ids=lambda case: case.__name__)
def test_a_failure_is_provoked_named_and_helped(case, graphene, monkeypatch):
    monkeypatch.setattr(stability, "DATA", graphene)
    found, kept = case(), RECORD[case.__name__]
    failed, helped = found.remedy
    assert failed < 0 < helped or 0 <= helped < failed / 2
    assert found.said == kept["said"]
    assert failed == pytest.approx(kept["remedy"][0], rel=0.1)
    assert helped == pytest.approx(kept["remedy"][1], rel=0.3, abs=1e-6)


def test_the_page_has_each_case_with_its_message_and_numbers():
    assert [*SECTIONS] == [case.__name__ for case in stability.CASES] == [*RECORD]
    for name, text in SECTIONS.items():
        assert f"```text\n{RECORD[name]['said']}\n```" in text
        for number in RECORD[name]["remedy"]:
            assert f"**{readable(f'{number:.2g}')}" in text, (name, number)


def test_symptoms_of_the_table_are_words_of_messages():
    code = [
        path.read_text("utf-8")
        for way in ("warp_peri", "examples")
        for path in (ROOT / way).rglob("*.py")
    ]
    known = re.sub(r'"\s+f?"', "", "\n".join(code)) + "\n".join(
        kept["said"] for kept in RECORD.values()
    )
    page = (ROOT / "docs/reference/messages.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, re.M)
    assert len(rows) <= 30
    for words in re.findall(r"`([^`]+)`", "\n".join(rows)):
        assert words in known, words


def test_a_call_that_says_nothing_is_no_failure():
    with pytest.raises(RuntimeError, match="expected an error or a warning"):
        said_by(lambda: None)


def test_one_case_is_printed_and_nothing_is_written(capsys, tmp_path):
    assert stability.main(["--only", "short_horizon", "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["short_horizon"]["title"] == "a short horizon"
    assert not any(tmp_path.iterdir())
