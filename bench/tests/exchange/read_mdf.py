"""Compares rows.mf4 and samples.mf4 in a folder with the CSV tables beside them."""

import sys

from asammdf import MDF

import tables

folder = sys.argv[1]
for samples in ["rows", "samples"]:
    with MDF(f"{folder}/{samples}.mf4") as mdf:
        assert mdf.version == "4.10", mdf.version
        assert len(mdf.file_history) == 1 and "rec-bench" in mdf.file_history[0].comment
        comment = mdf.header.comment
        for word in ["square-wave", "emulated &amp; small", "name = &quot;a&quot;"]:
            plain = word.replace("&amp;", "&").replace("&quot;", '"')
            assert word in comment or plain in comment, comment
        names = [group.channel_group.acq_name for group in mdf.groups]
        assert names == [samples, "events", "amplifier"], names
        for number, (table, group) in enumerate(zip(names, mdf.groups)):
            expected = tables.read(folder, table)
            assert [channel.name for channel in group.channels] == list(expected), table
            assert mdf.masters_db[number] == 0, "the time is the master"
            for index, (name, texts) in enumerate(expected.items()):
                signal = mdf.get(group=number, index=index)
                assert signal.unit == tables.unit(name), (name, signal.unit)
                assert signal.comment, name
                assert len(signal.samples) == len(texts), name
                flag = signal.samples.dtype.kind == "u" and signal.samples.dtype.itemsize == 1
                for at, (value, text) in enumerate(zip(signal.samples.tolist(), texts)):
                    if isinstance(value, bytes):
                        value = value.decode("utf-8").rstrip("\0")
                    assert tables.same(bool(value) if flag else value, text), (table, name, at, value, text)
                for time, text in zip(signal.timestamps.tolist(), expected["time_s"]):
                    assert tables.same(time, text), (table, name, time, text)
print("all values agree")
