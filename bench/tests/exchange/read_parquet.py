"""Compares the Parquet files in a folder with the CSV tables beside them."""

import sys

import pyarrow.parquet as parquet

import tables

folder = sys.argv[1]
for table in ["rows", "samples", "events", "amplifier"]:
    expected = tables.read(folder, table)
    read = parquet.read_table(f"{folder}/{table}.parquet")
    assert read.column_names == list(expected), table
    metadata = {key.decode(): value.decode() for key, value in read.schema.metadata.items()}
    assert metadata["table"] == table and metadata["protocol"] == "square-wave", metadata
    for name, texts in expected.items():
        assert metadata.get("unit." + name, "") == tables.unit(name), name
        assert metadata["about." + name], name
        values = read.column(name).to_pylist()
        assert len(values) == len(texts), name
        for at, (value, text) in enumerate(zip(values, texts)):
            assert tables.same(value, text), (table, name, at, value, text)
print("all values agree")
