"""What a campaign says as Markdown: whole tables, and a figure of what drives its metrics."""

import re
import xml.etree.ElementTree as ET

from bench.campaign.markdown import write
from bench.campaign.results import read
from bench.campaign.summary import summary

from .conftest import ABOVE, made_up_rows, with_trouble


def test_the_page_has_whole_tables_with_the_summarys_figures(campaign_of, tmp_path):
    folder = campaign_of(with_trouble(made_up_rows(200), 3, "crashed", "signal 11 | in\ntwo lines"))
    page = write(folder, tmp_path / "page.md").read_text(encoding="utf-8")
    told = summary(read(folder))
    for row in (*told.shares, *told.choices, *told.quantiles):
        assert f"| {' | '.join(row)} |" in page
    assert "| crashed | 1 | 3 | signal 11 \\| in two lines |" in page
    tables = re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE)
    assert len(tables) == 5
    for table in tables:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1


def test_the_figure_has_a_bar_for_each_of_the_strongest_inputs(campaign_of, tmp_path):
    page = write(campaign_of(made_up_rows(400)), tmp_path / "page.md")
    figure = tmp_path / "page-drives.svg"
    assert f"({figure.name})" in page.read_text(encoding="utf-8")
    root = ET.fromstring(figure.read_text(encoding="utf-8"))
    words = [each.text for each in root.iter("{http://www.w3.org/2000/svg}text")]
    assert words.index("least_clearance_m") < words.index("formation_time_s")
    # The clearance follows lambda_f, so that its bar is the first and the longest.
    assert words[words.index("least_clearance_m") + 1] == "road.lambda_f"
    widths = [float(each.get("width", "0")) for each in root.iter("{http://www.w3.org/2000/svg}rect")]
    assert len(widths) == 6
    assert widths[0] == max(widths[:3])


def test_without_influences_there_is_no_figure(campaign_of, tmp_path):
    page = write(campaign_of(made_up_rows(20)), tmp_path / "page.md").read_text(encoding="utf-8")
    assert not (tmp_path / "page-drives.svg").exists()
    assert "drives" not in page
    assert ABOVE in page
