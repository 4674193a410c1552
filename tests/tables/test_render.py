"""The report says what the results say: winners, rivals that win, failures, the paper's numbers."""

from riemlayer.tables import paper, render


def result(row: dict, **more) -> dict:
    mean = {"shapes": 2, "r0.5": row, "time": {"log": 0.01}, "at_p": {"log_zero": 0.0}}
    return {"settings": "X()", "shapes": {}, "groups": {"manmade": mean}, "failed": {}} | more


RESULTS = {
    "base": result({"mdd": 0.2, "angle": 11.0, "exp": 0.03}),
    "heat": result({"mdd": 0.1, "angle": 12.0}, failed={"manmade/cup": "RuntimeError: singular"}),
    "floor": result({"mdd": 0.05, "angle": 3.0}),
}


def cells(text: str, title: str) -> list[str]:
    (line,) = (line for line in text.splitlines() if line.startswith(f"| {title} "))
    return [cell.strip() for cell in line.split("|")[2:-1]]


def test_the_best_of_a_column_is_bold_also_where_it_is_a_rival_and_never_the_floor():
    text = render.group_table(RESULTS, "manmade")
    assert cells(text, "riemlayer base")[:5] == ["0.200", "–", "**11.0**", "–", "**0.0300**"]
    assert cells(text, "Heat (point cloud)")[:5] == ["**0.100**", "–", "12.0", "–", "–"]
    assert "**" not in "".join(cells(text, "the truth (floor)"))


def test_the_papers_numbers_stand_beside_ours_and_are_marked():
    text = render.group_table(RESULTS, "manmade")
    row = cells(text, "*paper, ShapeNet: ours*")
    assert row[0] == "*0.110*" and row[2] == "*11.1*" and row[4] == "*0.0260*"
    assert all(cell.startswith("*") for cell in row)
    assert "paper" not in render.group_table(RESULTS, "manmade", "r0.5_tight", times=False)


def test_failures_and_settings_are_in_the_report():
    text = render.report(RESULTS, {"cores": 2}, kept=3)
    assert "- heat on manmade/cup: RuntimeError: singular" in text
    assert "`X()`" in text and "3 rows" in text
    assert all(note in text for note in render.NOTES)


def test_a_small_number_is_not_shown_as_zero():
    assert render.number(1.2e-7, 4) == "1.2e-07"
    assert render.number(0.0, 4) == "0.0000"
    assert render.number(0.00005, 4) == "0.0001"
    assert render.number(None, 4) == "–"


def test_an_ablation_shows_cost_relative_to_the_first_and_its_steps():
    facts = {
        "full": {"seconds_a_step": 0.5, "steps": 600},
        "simple_loss": {"seconds_a_step": 0.25, "steps": 600},
    }
    results = {name: RESULTS["base"] for name in facts}
    text = render.ablation_table(results, facts, ["full", "simple_loss", "gone"], "manmade", "T3")
    assert cells(text, "simple loss")[5:7] == ["600", "0.50x"]
    assert cells(text, "full")[7] == "*0.112 / 11.2 / 0.028*"


def test_every_group_with_a_counterpart_has_all_four_rows():
    for category, table in paper.COUNTERPART.values():
        assert set(table[category]) == {"heat", "tracing", "projection", "paper"}
