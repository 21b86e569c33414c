"""A page to look at: tables, charts, pictures and playable scenes of runs in one HTML file."""

from diffstack_mmv.reporting.html.evaluation import HORIZON_FILE, SCENES_FILE, horizon_content
from diffstack_mmv.reporting.html.page import render, write_page
from diffstack_mmv.reporting.html.readers import RunPage, Titles, names_apart, read_page
from diffstack_mmv.reporting.html.records import RunRecord, read_record

__all__ = [
    "HORIZON_FILE",
    "SCENES_FILE",
    "RunPage",
    "RunRecord",
    "Titles",
    "horizon_content",
    "names_apart",
    "read_page",
    "read_record",
    "render",
    "write_page",
]
