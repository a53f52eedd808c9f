"""Makes the codestreams beside this file out of the picture that `compressed.rs` knows: pip install numpy imagecodecs."""
import pathlib

import imagecodecs
import numpy

COLUMNS, ROWS = 48, 40
y, x = numpy.mgrid[:ROWS, :COLUMNS]
disc = (x - 24) ** 2 + (y - 20) ** 2 < 300
hounsfield = numpy.where(disc, 40 + (x * 7 + y * 13) % 29 + x, -1000 + (x * y) % 7)
unsigned, signed = (hounsfield + 1024).astype("uint16"), hounsfield.astype("int16")
eight = ((hounsfield + 1024) // 16).clip(0, 255).astype("uint8")

made = {
    "baseline.jpg": imagecodecs.jpeg8_encode(eight, level=95),
    "lossless.jpg": imagecodecs.ljpeg_encode(unsigned, bitspersample=12),
    "lossless.jls": imagecodecs.jpegls_encode(unsigned),
    "near3.jls": imagecodecs.jpegls_encode(unsigned, level=3),
    "eight.jls": imagecodecs.jpegls_encode(eight),
    "reversible.j2k": imagecodecs.jpeg2k_encode(unsigned, reversible=True, level=0, codecformat="j2k", bitspersample=12),
    "signed.j2k": imagecodecs.jpeg2k_encode(signed, reversible=True, level=0, codecformat="j2k"),
    "irreversible.j2k": imagecodecs.jpeg2k_encode(unsigned, reversible=False, level=70, codecformat="j2k", bitspersample=12),
    "eight.j2k": imagecodecs.jpeg2k_encode(eight, reversible=True, level=0, codecformat="j2k"),
    "high_throughput.j2k": imagecodecs.htj2k_encode(unsigned),
}
for name, data in made.items():
    pathlib.Path(__file__).with_name(name).write_bytes(bytes(data))
