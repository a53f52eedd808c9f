"""Reads a folder of the phantom with pydicom and prints what it finds, one line a fact."""

import pathlib
import sys

import pydicom

folder = pathlib.Path(sys.argv[1])
slices = [pydicom.dcmread(p) for p in sorted(folder.glob("ct_*.dcm"))]
slices.sort(key=lambda s: s.ImagePositionPatient[2])
print("slices", len(slices), slices[0].Columns, slices[0].Rows)
print("class", slices[0].SOPClassUID.name)
print("unique", len({s.SOPInstanceUID for s in slices}), len({s.SeriesInstanceUID for s in slices}))
print("sum", sum(int((s.pixel_array.astype("int64") * int(s.RescaleSlope) + int(s.RescaleIntercept)).sum()) for s in slices))
seg = pydicom.dcmread(folder / "seg.dcm")
print("segmentation", seg.SOPClassUID.name, seg.SegmentationType, seg.FrameOfReferenceUID == slices[0].FrameOfReferenceUID)
known = {s.SOPInstanceUID for s in slices}
referenced = seg.ReferencedSeriesSequence[0].ReferencedInstanceSequence
print("referenced", all(r.ReferencedSOPInstanceUID in known for r in referenced))
frames = seg.pixel_array
counts = {}
for frame, group in zip(frames, seg.PerFrameFunctionalGroupsSequence):
    number = group.SegmentIdentificationSequence[0].ReferencedSegmentNumber
    counts[number] = counts.get(number, 0) + int(frame.sum())
for item in seg.SegmentSequence:
    print("segment", item.SegmentNumber, item.SegmentLabel, counts.get(item.SegmentNumber, 0))
