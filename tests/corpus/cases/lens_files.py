"""Lens files whose form is right and whose content is not that of a headset."""

import json
from collections.abc import Iterator
from typing import Any

from corpus.base_texts import LENS_SEQ, LENS_ZMX, OPTILAND, RAYOPTICS
from corpus.case import Case, Change, replaced, written
from corpus.cases.hostile_files import OPTICS
from corpus.damage import Keys, with_value

# By name: old and new text of the Zemax file, and a word of the sentence.
ZEMAX: dict[str, tuple[str, str, str]] = {
    "a curvature of nan": ("CURV 0.02", "CURV nan", "line 10"),
    "a curvature of inf": ("CURV 0.02", "CURV inf", "line 10"),
    "a distance of 400 digits": ("DISZ 45", "DISZ " + "9" * 400, "DISZ"),
    "millimetres stated as metres": ("UNIT MM", "UNIT METER", "plausible|length|convert its unit"),
    "a glass of escapes": ("GLAS CORPUS", "GLAS \x1b[31m\u202e", "catalogue"),
    "a glass of index 0": ("GLAS CORPUS 0 0 1.5 40", "GLAS ___BLANK 1 0 0 60", "index"),
    "a glass of index nan": ("GLAS CORPUS 0 0 1.5 40", "GLAS ___BLANK 1 0 nan 60", "GLAS"),
    "a glass of Abbe number 1e-300": ("GLAS CORPUS 0 0 1.5 40", "GLAS ___BLANK 1 0 1.5 1e-300", "index|vd"),
    "a normalisation of 1e-30": ("XDAT 2 10", "XDAT 2 1e-30", "XDAT 2"),
    "a normalisation of 1e12 and 500 terms": ("XDAT 1 1\n  XDAT 2 10", "XDAT 1 500\n  XDAT 2 1e12", "XDAT 2"),
    "a parameter of number 1e9": ("PARM 2 1e-6", "PARM 1000000000 1e-6", "PARM"),
    "a term of 1e12": ("PARM 2 1e-6", "PARM 10 1e12", "lens.zmx"),
    "a turn of nan": ("PARM 1 0.5", "PARM 3 nan", "PARM"),
    "no stop": ("  STOP\n", "", "--pupil-surface"),
    "no lens": ("  GLAS CORPUS 0 0 1.5 40\n", "", "no mirror or glass"),
    "an aperture without a number": ("CLAP 0 18 0", "CLAP 0", "CLAP"),
    "no surface after the head": (LENS_ZMX, "UNIT MM\nMODE SEQ\n", "SURF"),
    "300000 surfaces": (LENS_ZMX, "".join(f"SURF {number}\n" for number in range(300_000)), "300000 surfaces"),
    "over 10^6 surfaces": (LENS_ZMX, "SURF 1\n" * 1_250_000, "8 MB"),
    "101 lenses": (
        LENS_ZMX,
        "SURF 0\n  DISZ INFINITY\nSURF 1\n  STOP\n"
        + "".join(f"SURF {number}\n  GLAS ___BLANK 1 0 1.{number} 60\n" for number in range(100, 250)).replace(
            "SURF 1", "SURF "
        )
        + "SURF 152\n",
        "surface",
    ),
}
# By name: old and new text of the CODE V file, and a word of the sentence.
CODE_V: dict[str, tuple[str, str, str]] = {
    "a radius of nan": ("S 50.0", "S nan", "line 12"),
    "a radius of 1e-320": ("S 50.0", "S 1e-320", "lens.seq"),
    "a thickness of 400 digits": ("S 50.0 5.0", "S 50.0 " + "9" * 400, "line 12"),
    "no thickness": ("S 0.0 45.0", "S 0.0", "line 19"),
    "metres stated as millimetres": ("S 0.0 45.0", "S 0.0 0.045e6", "plausible|length|convert its unit"),
    "a command of surface 999999": ("CIR 18", "CIR S999999 18", "S999999"),
    "a glass that is missing": ("CORPUS_MAKER", "NO-SUCH-1", "NO-SUCH-1"),
    "a glass of escapes": ("CORPUS_MAKER", "\x1b[31m\u202e", "catalogue"),
    "a glass of index 0": ("CORPUS_MAKER", "0.0 60", "index"),
    "a glass of index nan": ("1.61 1.62", "nan 1.62", "MINE"),
    "a glass of 400 digits": ("CORPUS_MAKER", "517." + "9" * 400, "lens.seq"),
    "a glass of two indices": ("1.62 &\n   1.63", "", "PWL"),
    "a glass at no wavelength": ("PWL 656.3 587.6 486.1", "PWL 0 1e-300 1e12", "PWL"),
    "a glass by an unknown formula": ("'MINE' 1.61", "'MINE' XYZ 1.61", "LAU"),
    "a normalisation of 1e-30": ("XYP 10", "XYP 1e-30", "NRADIUS"),
    "a term of 1e12": ("A 1e-6", "J 1e12", "lens.seq"),
    "a coefficient of nan": ("C4 1e-4", "C4 nan", "SCO"),
    "a turn of inf": ("ADE 1.0", "ADE inf", "ADE"),
    "an aperture of -18": ("CIR 18", "CIR -18", "CIR"),
    "no stop": ("  STO\n", "", "--pupil-surface"),
    "no surface": (LENS_SEQ, "RDM;LEN\nDIM M\nGO\n", "0 surfaces"),
    "50000 surfaces": (LENS_SEQ, "SO 0 1e11\n" + "S 0 1\n" * 50_000, "50002 surfaces"),
    "continued without end": (LENS_SEQ, "RDM;LEN\nSO 0 " + "&\n" * 100_000, "surfaces"),
}
# By name: old and new text of the catalogue, and a word of the sentence.
CATALOGUES: dict[str, tuple[str, str, str]] = {
    "a weak pole in visible light": ("2.317923440E-01 2.001791440E-02", "1e-6 0.36", "infinite at 0.6 um"),
    "a coefficient of 1e308": ("1.039612120E+00", "1e308", "index at"),
    "a pole in green light": ("6.000698670E-03", "0.30250000000000005", "index"),
    "a pole in blue light": ("6.000698670E-03", "0.2116", "index"),
    "a formula of 400 digits": ("CORPUS 2 ", f"CORPUS {'9' * 400} ", "not numbers"),
    "another glass": ("NM CORPUS", "NM BORPUS", "CORPUS"),
}
SURFACE = ("surface_group", "surfaces", 2)
INTERFACES = ("optical_model", "attributes", "seq_model", "attributes")


def _nested(depth: int) -> dict[str, Any]:
    frame: dict[str, Any] = {"z": 1.0}
    for _ in range(depth):
        frame = {"z": 1.0, "reference_cs": frame}
    return frame


# By name: keys and value, and a word of the sentence.
OF_OPTILAND: dict[str, tuple[Keys, Any, str]] = {
    "frames in 100 frames": ((*SURFACE, "geometry", "cs"), _nested(100), "in one another"),
    "terms of 400 digits": ((*SURFACE, "geometry", "coefficients"), [10**400], "coefficients"),
    "terms of text": ((*SURFACE, "geometry", "coefficients"), ["x"], "coefficients"),
    "terms of terms of terms": ((*SURFACE, "geometry", "coefficients"), [[[1.0]]], "coefficients"),
    "1000 terms": ((*SURFACE, "geometry", "coefficients"), [1.0] * 1000, "coefficients"),
    "a toroid of text": ((*SURFACE[:2], 3, "geometry", "coeffs_poly_y"), "x", "coeffs_poly_y"),
    "a radius of 1e-320": ((*SURFACE, "geometry", "radius"), 1e-320, "optiland.json"),
    "a place to the side at infinity": ((*SURFACE[:2], 0, "geometry", "cs", "x"), float("inf"), "'x'"),
    "a material that is none": ((*SURFACE, "material_post", "type"), "Vacuum", "Vacuum"),
    "a mirror that is a text": ((*SURFACE, "interaction_model", "is_reflective"), "no", "is_reflective"),
    "an aperture of -18": ((*SURFACE, "aperture", "r_max"), -18.0, "optiland.json"),
    "2000 surfaces": (SURFACE[:2], OPTILAND["surface_group"]["surfaces"] * 400, "2000"),
    "2 surfaces": (SURFACE[:2], OPTILAND["surface_group"]["surfaces"][:2], "2 surfaces"),
}
OF_RAYOPTICS: dict[str, tuple[Keys, Any, str]] = {
    "a gap too few": ((*INTERFACES, "gaps"), [], "gaps"),
    "a stop that is not there": ((*INTERFACES, "stop_surface"), 9, "stop_surface"),
    "a decentre of another kind": ((*INTERFACES, "ifcs", 2, "attributes", "decenter", "attributes", "_dtype"), "x", "decentre"),
    "a mirror of an older version": ((*INTERFACES, "ifcs", 2, "attributes"), {"refract_mode": "REFL"}, "interact_mode"),
    "a glass without a class": ((*INTERFACES, "gaps", 2, "attributes", "medium"), {"attributes": {}}, "__instance_type__"),
    "a profile that is not there": ((*INTERFACES, "ifcs", 3, "attributes", "profile"), 5, "profile"),
    "furlongs": (("optical_model", "attributes", "system_spec", "attributes", "_dimensions"), "furlong", "furlong"),
    "metres": (("optical_model", "attributes", "system_spec", "attributes", "_dimensions"), "m", "plausible|length|convert its unit"),
}  # fmt: skip


def cases() -> Iterator[Case]:
    files = ("lens.zmx", "glasses.agf")
    zemax = ("import-lens", "lens.zmx", *OPTICS)
    for title, (old, new, word) in ZEMAX.items():
        yield Case(f"Zemax: {title}", zemax, files, replaced("lens.zmx", old, new), ("lens.zmx", word))
    code_v = ("import-lens", "lens.seq", *OPTICS)
    for title, (old, new, word) in CODE_V.items():
        change = replaced("lens.seq", old, new)
        yield Case(f"CODE V: {title}", code_v, ("lens.seq", "glasses.agf"), change, ("lens.seq", word))
    for title, (old, new, word) in CATALOGUES.items():
        change = replaced("glasses.agf", old, new)
        yield Case(f"glass catalogue: {title}", zemax, files, change, ("glasses.agf|lens.zmx", word))
    for file, content, wrong in (("optiland.json", OPTILAND, OF_OPTILAND), ("rayoptics.roa", RAYOPTICS, OF_RAYOPTICS)):
        for title, (keys, value, word) in wrong.items():
            change = _json(file, with_value(content, keys, value))
            yield Case(f"{file}: {title}", ("import-lens", file, *OPTICS), ("glasses.agf",), change, (file, word))
    tiny = replaced("lens.zmx", "CURV 0.02", "CURV 1e6")
    yield Case("Zemax: a radius of a nanometre", zemax, files, tiny, ("do not reach the panel",), "warned")
    deep = written("optiland.json", '{"surface_group": ' * 100_000 + "1" + "}" * 100_000)
    yield Case("optiland.json: nested 100000 deep", ("import-lens", "optiland.json", *OPTICS), files, deep, ("nested",))


def _json(file: str, content: Any) -> Change:
    return written(file, json.dumps(content))
