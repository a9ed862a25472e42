"""The CSV tables that the other formats are compared with."""

import csv
import math
import os

UNITS = {
    "s": "s", "v": "V", "deg": "deg", "bar": "bar", "nm": "Nm", "ml": "ml", "ns": "ns", "a": "A", "rpm": "rpm", "c": "degC",
}


def read(folder, table):
    """Columns by name, as text."""
    with open(os.path.join(folder, table + ".csv"), newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    return {name: [row[index] for row in rows[1:]] for index, name in enumerate(rows[0])}


def unit(name):
    return UNITS.get(name.rsplit("_", 1)[-1], "") if "_" in name else ""


def same(value, text):
    """Whether a value of another program is the one in the CSV field, bit for bit."""
    if value is None:
        return text == ""
    if isinstance(value, str):
        return value == text
    if isinstance(value, bool):
        return text == ("1" if value else "0")
    if isinstance(value, int):
        return text == str(value)
    if math.isnan(value):
        return text == ""
    return text != "" and float(text) == value and math.copysign(1, float(text)) == math.copysign(1, value)
