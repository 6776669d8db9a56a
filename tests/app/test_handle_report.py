"""The report on one page: what the designer and ``analyze`` say of a filter, in a file that needs nothing else."""

from __future__ import annotations

import base64
import html
import re
import xml.etree.ElementTree as ET
from typing import Literal

import pytest
from designer_messages import answered, message_of, refused

import phyfilter_ctl as pf
from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.cli import main

LIMITS: dict[str, object] = {"error": {"omega": 1.0, "level": 0.1}}
DESIGN = message_of(pf.lowpass(2, 20.0, family="butterworth").poles.tolist(), limits=LIMITS)


def made(format: Literal["html", "pdf"], name: str = "") -> tuple[dict, bytes]:
    reply = answered(Session(), "report", design=DESIGN, format=format, name=name)
    return reply, base64.b64decode(reply["base64"], validate=True)


def needs_nothing(text: str) -> None:
    """No script, and nothing that a browser would fetch."""
    assert "<script" not in text
    assert not re.search(r'(?:src|href)="(?!#)', text)
    assert "url(http" not in text


@pytest.mark.slow
def test_the_report_holds_verdict_figures_filter_assumptions_and_pictures():
    reply, data = made("html", "left <wing>")
    assert re.fullmatch(r"left_wing-[0-9a-f]{8}-report\.html", reply["name"])
    text = data.decode()
    needs_nothing(text)
    answer = answered(Session(), "design", design=DESIGN)
    for said in [each["text"] for each in answer["verdict"]] + [each["label"] for each in answer["numbers"]]:
        assert html.escape(said) in text, said
    for said in (
        "left &lt;wing&gt;",
        "pf.lowpass(2, 20.0, family=",
        "actuator lag",
        "0.02 s",
        pf.__version__,
    ):
        assert said in text, said
    assert "<wing>" not in text
    picture = ET.fromstring(text[text.index("<svg") : text.index("</svg>") + 6])
    assert len(list(picture.iter("{http://www.w3.org/2000/svg}path"))) > 20  # drawn, not a bitmap
    assert not list(picture.iter("{http://www.w3.org/2000/svg}image"))


@pytest.mark.slow
def test_the_report_is_one_page_of_pdf_and_the_same_each_time():
    reply, data = made("pdf")
    assert re.fullmatch(r"butterworth_2_20-[0-9a-f]{8}-report\.pdf", reply["name"])
    assert data.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", data)) == 1
    assert made("pdf")[1] == data


@pytest.mark.slow
def test_analyze_writes_the_same_page(tmp_path, capsys):
    file, report = tmp_path / "wing.toml", tmp_path / "wing.html"
    pf.save(file, pf.lowpass(2, 20.0, family="butterworth"))
    asked = ["analyze", str(file), "--slope", "3", "--lag", "0.02"]
    assert main([*asked, "--report", str(report)]) == 0
    text = report.read_text(encoding="utf-8")
    needs_nothing(text)
    assert '<span class="good">Stable.</span>' in text or '<span class="good">Stable. ' in text
    assert "Tolerates" in text
    printed = capsys.readouterr().out
    for figure in ("gain margin", "delay margin", "bound"):
        value = (
            next(line for line in printed.splitlines() if line.strip().startswith(figure))
            .split(figure)[1]
            .strip()
        )
        assert html.escape(value) in text, figure
    assert main([*asked, "--report", str(tmp_path / "wing.pdf")]) == 0
    assert (tmp_path / "wing.pdf").read_bytes().startswith(b"%PDF")


def test_formats_are_checked():
    assert refused(Session(), "report", design=DESIGN, format="docx")["where"] == "format"
