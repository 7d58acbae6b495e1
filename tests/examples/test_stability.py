"""Fifteen failures: each occurs, says what its page prints, and is smaller with the remedy."""

import re

from examples import stability
from tests.support import ROOT, approx, filterwarnings, of_json, parametrize

RECORD = of_json(ROOT / "docs/record/stability.json")["cases"]
PAGE = (ROOT / "docs/explanation/where_it_fails.md").read_text("utf-8")
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
WORST = {"no_conditions": 22.5, "noisy_data": 4.0, "small_holes": 50.0, "critical_stretch": 3.0}
SECTIONS = dict(re.findall(r"^### [^{]+\{#([\w-]+)\}\n(.*?)(?=^##|\Z)", PAGE, re.M | re.S))


def readable(number):
    """A number as a page shows it: 9.4e-05 as 9.4·10⁻⁵, 1.2e+02 as 120, a minus as such."""
    digits, _, power = number.partition("e")
    if power and 0 <= int(power) <= 3:
        digits, power = f"{float(number):g}", ""
    raised = f"·10{f'{int(power)}'.translate(RAISED)}" if power else ""
    return digits.replace("-", "−") + raised


@filterwarnings("ignore")
@parametrize("case", stability.CASES, ids=lambda case: case.__name__)
def test_a_failure_is_provoked_named_and_helped(case, graphene, monkeypatch):
    monkeypatch.setattr(stability, "DATA", graphene)
    name = case.__name__
    found, kept = case((WORST[name],)) if name in WORST else case(), RECORD[name]
    failed, helped = found.remedy
    assert failed < 0 < helped or 0 <= helped < failed / 2
    assert found.said == kept["said"]
    assert failed == approx(kept["remedy"][0], rel=0.1)
    assert helped == approx(kept["remedy"][1], rel=0.3, abs=1e-6)
    text = SECTIONS[name.replace("_", "-")]
    assert f"```text\n{kept['said']}\n```" in text
    assert all(f"**{readable(f'{number:.2g}')}" in text for number in kept["remedy"])


def test_symptoms_of_the_table_are_words_of_messages():
    code = "\n".join(p.read_text("utf-8") for p in (ROOT / "warp_peri").rglob("*.py"))
    known = re.sub(r'"\s+f?"', "", code) + "\n".join(kept["said"] for kept in RECORD.values())
    rows = re.findall(r"^\| (`.*?) \|", (ROOT / "docs/reference/messages.md").read_text(), re.M)
    assert len(rows) <= 30
    for words in re.findall(r"`([^`]+)`", "\n".join(rows)):
        assert words in known, words
