"""Files as scanners, 3D Slicer and other programs write them, field by field."""

import gzip
import struct
from contextlib import nullcontext
from datetime import datetime

import highdicom
import numpy as np
import pydicom
import pytest
import SimpleITK
from highdicom.sr import CodedConcept
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

from needleforce.anatomy import VolumeError

SPACING_mm = np.array([0.8, 0.9, 1.25])
ORIGIN_mm = np.array([-10.0, 20.0, 33.33])
AXES = np.eye(3)


def place_mm(index):
    """Where a voxel (i, j, k) of slices or of a segmentation lies."""
    return ORIGIN_mm + SPACING_mm * np.asarray(index)


def refused_if(is_wrong, word, error: type[Exception] = VolumeError):
    """Expects that a volume, or something else, is refused with a word, or is not."""
    return pytest.raises(error, match=word) if is_wrong else nullcontext()


def write_image(
    path,
    values,
    spacing_mm=(1.0, 1.0, 1.0),
    origin_mm=(0.0, 0.0, 0.0),
    axes=None,
    fields=None,
):
    """Write voxels (i, j, k), or layers of such, in the format of the name.

    Args:
        axes: Directions of i, j and k as columns, if they are not x, y and z.
        fields: Further fields of the header.
    """
    image = SimpleITK.GetImageFromArray(
        np.ascontiguousarray(values.T), isVector=values.ndim > 3
    )
    image.SetSpacing(list(spacing_mm))
    image.SetOrigin(list(origin_mm))
    if axes is not None:
        image.SetDirection(np.ravel(axes).tolist())
    for key, text in (fields or {}).items():
        image.SetMetaData(key, str(text))
    SimpleITK.WriteImage(image, str(path))


def patch(path, place, kind, *numbers):
    """Put other numbers at a place of a file."""
    content = bytearray(path.read_bytes())
    struct.pack_into(f"<{kind}", content, place, *numbers)
    path.write_bytes(content)


def ct_slices(shape, places_mm=None, axes=AXES, series=2):
    """Slices of a CT with (i, j, k) voxels, whose first pixels lie at places (k, 3)."""
    if places_mm is None:
        places_mm = [place_mm([0, 0, k]) for k in range(shape[2])]
    slices = []
    for k, place in enumerate(places_mm):
        item = Dataset()
        item.file_meta = FileMetaDataset()
        item.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        item.file_meta.MediaStorageSOPClassUID = CTImageStorage
        uid = pydicom.uid.UID(f"2.25.{1000 * series + k}")
        item.file_meta.MediaStorageSOPInstanceUID = uid
        fields = {
            "SOPClassUID": CTImageStorage,
            "SOPInstanceUID": uid,
            "StudyInstanceUID": "2.25.1",
            "SeriesInstanceUID": f"2.25.{series}",
            "FrameOfReferenceUID": "2.25.3",
            "PatientID": "1",
            "PatientName": "Torso^Analytic",
            "PatientBirthDate": "",
            "PatientSex": "",
            "StudyID": "1",
            "StudyDate": datetime(2026, 1, 1).date(),
            "StudyTime": datetime(2026, 1, 1).time(),
            "AccessionNumber": "",
            "ReferringPhysicianName": "",
            "PositionReferenceIndicator": "",
            "Modality": "CT",
            "SeriesNumber": series,
            "InstanceNumber": k + 1,
            "ImagePositionPatient": [f"{one:.10g}" for one in place],
            "ImageOrientationPatient": [f"{one:.10g}" for one in axes[:, :2].T.ravel()],
            "PixelSpacing": [SPACING_mm[1], SPACING_mm[0]],
            "SliceThickness": SPACING_mm[2],
            "Rows": shape[1],
            "Columns": shape[0],
            "BitsAllocated": 16,
            "BitsStored": 16,
            "HighBit": 15,
            "PixelRepresentation": 1,
            "SamplesPerPixel": 1,
            "PhotometricInterpretation": "MONOCHROME2",
            "PixelData": np.zeros(shape[1::-1], np.int16).tobytes(),
        }
        for name, value in fields.items():
            setattr(item, name, value)
        slices.append(item)
    return slices


def write_series(folder, slices):
    """Write slices into a folder, one file each."""
    folder.mkdir(parents=True, exist_ok=True)
    for item in slices:
        item.save_as(
            folder / f"{item.SeriesNumber}-{item.InstanceNumber:03d}.dcm",
            enforce_file_format=True,
        )


def segment(number, label, what, side=None):
    """The description of a segment."""
    described = highdicom.seg.SegmentDescription(
        number,
        label,
        CodedConcept("123037004", "SCT", "Anatomical Structure"),
        CodedConcept("0", "SCT", what),
        "MANUAL",
    )
    if side is not None:
        (term,) = described.SegmentedPropertyTypeCodeSequence
        term.SegmentedPropertyTypeModifierCodeSequence = pydicom.Sequence(
            [CodedConcept("7771000", "SCT", side)]
        )
    return described


def write_dicom_segmentation(path, masks, segments, kind="BINARY"):
    """Write masks (i, j, k) as a DICOM segmentation."""
    stack = np.stack([mask.T for mask in masks], axis=-1).astype(np.uint8)
    if kind == "LABELMAP":
        stack = (stack * np.arange(1, len(masks) + 1, dtype=np.uint8)).max(axis=-1)
    elif kind == "FRACTIONAL":
        stack = stack.astype(np.float32)
    uids = [pydicom.uid.UID(f"2.25.{number}") for number in (4, 5)]
    maker = ("needleforce", "test", "1", "1")
    highdicom.seg.Segmentation(
        ct_slices(masks[0].shape),
        *(stack, kind, segments, uids[0], 2, uids[1], 1, *maker),
    ).save_as(path)


def slicer_tags(what, side="^^", region="^^"):
    """The tags of a segment of 3D Slicer: status and terms."""
    entry = f"General Anatomy~SCT^123037004^Anatomical Structure~SCT^0^{what}~{side}"
    return f"Segmentation.Status:x|TerminologyEntry:{entry}~Codes~{region}~^^|"


def write_seg_nrrd(path, layers, segments):
    """Write layers (i, j, k) and fields of segments as 3D Slicer does."""
    fields = {
        f"Segment{number}_{key}": text
        for number, segment in enumerate(segments)
        for key, text in {"ID": f"Segment_{number + 1}", **segment}.items()
    }
    values = np.stack(layers) if len(layers) > 1 else layers[0]
    write_image(path, values, SPACING_mm, ORIGIN_mm, fields=fields)


def write_labels_with_table(path, values, table):
    """Write labels whose names are an extension of the header, as TotalSegmentator."""
    plain = path.with_name("plain.nii")
    write_image(plain, values, (1.5, 1.5, 1.5))
    content = bytearray(plain.read_bytes())
    plain.unlink()
    size = 16 * -(-(len(table) + 8) // 16)
    struct.pack_into("<f", content, 108, 352.0 + size)
    extension = struct.pack("<2i", size, 0) + table.ljust(size - 8, b"\0")
    path.write_bytes(
        gzip.compress(content[:348] + b"\1\0\0\0" + extension + content[352:])
    )
