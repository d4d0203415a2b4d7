"""Files as scanners, 3D Slicer and other programs write them, field by field."""

import gzip
import struct
from datetime import datetime

import highdicom
import numpy as np
import pydicom
import SimpleITK
from highdicom.sr import CodedConcept
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

SPACING_mm = np.array([0.8, 0.9, 1.25])
ORIGIN_mm = np.array([-10.0, 20.0, 33.33])


def place_mm(index):
    """Where a voxel (i, j, k) of slices or of a segmentation lies."""
    return ORIGIN_mm + SPACING_mm * np.asarray(index)


def write_image(path, values, spacing_mm=(1.0, 1.0, 1.0), origin_mm=(0.0, 0.0, 0.0)):
    """Write voxels (i, j, k) in the format of the name."""
    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(values.T))
    image.SetSpacing(spacing_mm)
    image.SetOrigin(origin_mm)
    SimpleITK.WriteImage(image, str(path))


def patch(path, place, kind, *numbers):
    """Put other numbers at a place of a file."""
    content = bytearray(path.read_bytes())
    struct.pack_into(f"<{kind}", content, place, *numbers)
    path.write_bytes(content)


def ct_slices(shape, places_mm=None, turn=None, series=2):
    """Slices of a CT with (i, j, k) voxels, whose first pixels lie at places (k, 3)."""
    if places_mm is None:
        places_mm = [place_mm([0, 0, k]) for k in range(shape[2])]
    axes = np.eye(3) if turn is None else turn
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
        name = f"{item.SeriesNumber}-{item.InstanceNumber:03d}.dcm"
        item.save_as(folder / name, enforce_file_format=True)


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
        sides = pydicom.Sequence([CodedConcept("7771000", "SCT", side)])
        terms = described.SegmentedPropertyTypeCodeSequence
        terms[0].SegmentedPropertyTypeModifierCodeSequence = sides
    return described


def write_dicom_segmentation(path, masks, segments, kind="BINARY"):
    """Write masks (i, j, k) as a DICOM segmentation."""
    stack = np.stack([mask.T for mask in masks], axis=-1).astype(np.uint8)
    if kind == "LABELMAP":
        stack = (stack * np.arange(1, len(masks) + 1, dtype=np.uint8)).max(axis=-1)
    elif kind == "FRACTIONAL":
        stack = stack.astype(np.float32)
    uids = [pydicom.uid.UID(f"2.25.{number}") for number in (4, 5)]
    slices = ct_slices(masks[0].shape)
    maker = ("needleforce", "test", "1", "1")
    highdicom.seg.Segmentation(
        slices, stack, kind, segments, uids[0], 2, uids[1], 1, *maker
    ).save_as(path)


def slicer_tags(what, side="^^", region="^^"):
    """The tags of a segment of 3D Slicer: status and terms."""
    category = "SCT^123037004^Anatomical Structure"
    entry = f"General Anatomy~{category}~SCT^0^{what}~{side}"
    return f"Segmentation.Status:x|TerminologyEntry:{entry}~Codes~{region}~^^|"


def write_seg_nrrd(path, layers, segments):
    """Write layers (i, j, k) and fields of segments as 3D Slicer does."""
    values = np.stack(layers, axis=-1) if len(layers) > 1 else layers[0]
    image = SimpleITK.GetImageFromArray(values.swapaxes(0, 2), values.ndim > 3)
    image.SetSpacing(SPACING_mm.tolist())
    image.SetOrigin(ORIGIN_mm.tolist())
    for number, fields in enumerate(segments):
        for key, text in {"ID": f"Segment_{number + 1}", **fields}.items():
            image.SetMetaData(f"Segment{number}_{key}", str(text))
    SimpleITK.WriteImage(image, str(path))


def write_labels_with_table(path, values, table):
    """Write labels whose names are an extension of the header, as TotalSegmentator."""
    plain = path.with_name("plain.nii")
    write_image(plain, values, (1.5, 1.5, 1.5))
    content = bytearray(plain.read_bytes())
    plain.unlink()
    size = 16 * -(-(len(table) + 8) // 16)
    struct.pack_into("<f", content, 108, 352.0 + size)
    extension = struct.pack("<2i", size, 0) + table.ljust(size - 8, b"\0")
    header = bytes(content[:348]) + b"\1\0\0\0" + extension
    path.write_bytes(gzip.compress(header + content[352:]))
