"""The XML document around the data of a WINDOW or Radiance BSDF file."""

from __future__ import annotations

from xml.sax.saxutils import escape

from gonio.formats.klems import BASES

FULL = "LBNL/Klems Full"
TREE = "LBNL/Shirley-Chiu"


def document(name: str, tree: bool, data: dict[str, list[tuple[str, str]]]) -> str:
    """The whole file: `data` holds, by wavelength name, pairs of direction and text of the values."""
    basis = TREE if tree else FULL
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<WindowElement xmlns="http://windows.lbl.gov" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">',
        "<WindowElementType>System</WindowElementType>",
        "<FileType>BSDF</FileType>",
        "<Optical>",
        "<Layer>",
        f"<Material><Name>{escape(name)}</Name><Manufacturer>gonio</Manufacturer></Material>",
        "<DataDefinition>",
        f"<IncidentDataStructure>{'TensorTree3' if tree else 'Columns'}</IncidentDataStructure>",
        *([] if tree else _basis_definition()),
        "</DataDefinition>",
    ]
    for kind, sides in data.items():
        for where, text in sides:
            angle_basis = (
                [f"<AngleBasis>{basis}</AngleBasis>"]
                if tree
                else [
                    f"<ColumnAngleBasis>{basis}</ColumnAngleBasis>",
                    f"<RowAngleBasis>{basis}</RowAngleBasis>",
                ]
            )
            lines += [
                "<WavelengthData>",
                "<LayerNumber>System</LayerNumber>",
                f'<Wavelength unit="Integral">{kind}</Wavelength>',
                "<SourceSpectrum>CIE Illuminant E 1nm.ssp</SourceSpectrum>",
                "<DetectorSpectrum>ASTM E308 1931 Y.dsp</DetectorSpectrum>",
                "<WavelengthDataBlock>",
                f"<WavelengthDataDirection>{where}</WavelengthDataDirection>",
                *angle_basis,
                f"<ScatteringDataType>B{'T' if where.startswith('T') else 'R'}DF</ScatteringDataType>",
                "<ScatteringData>",
                text,
                "</ScatteringData>",
                "</WavelengthDataBlock>",
                "</WavelengthData>",
            ]
    return "\n".join([*lines, "</Layer>", "</Optical>", "</WindowElement>", ""])


def _basis_definition() -> list[str]:
    lines = ["<AngleBasis>", f"<AngleBasisName>{FULL}</AngleBasisName>"]
    bounds, counts = BASES[FULL]
    for n, count in enumerate(counts):
        centre = 0 if n == 0 else 0.5 * (bounds[n] + bounds[n + 1])
        lines += [
            f"<AngleBasisBlock><Theta>{centre:g}</Theta><nPhis>{count}</nPhis>",
            f"<ThetaBounds><LowerTheta>{bounds[n]:g}</LowerTheta>",
            f"<UpperTheta>{bounds[n + 1]:g}</UpperTheta></ThetaBounds>",
            "</AngleBasisBlock>",
        ]
    return [*lines, "</AngleBasis>"]
