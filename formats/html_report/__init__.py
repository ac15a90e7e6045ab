"""The HTML report of a run; `report.write_report` makes it."""
