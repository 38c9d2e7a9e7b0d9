"""report.json against the JSON Schema that the package ships."""

import json
from importlib.resources import files
from pathlib import Path

import jsonschema


def check_report(file: Path) -> None:
    """Fail where a capture's report is not as matcap/capture/report.schema.json says."""
    schema = json.loads(files("matcap.capture").joinpath("report.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(file.read_text()), schema)
