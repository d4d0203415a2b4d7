"""DICOM segmentations, written by highdicom beside slices of a CT."""

from datetime import datetime

import highdicom
import numpy as np
import pydicom
from highdicom.sr import CodedConcept
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

SPACING_mm = np.array([0.8, 0.9, 1.25])
ORIGIN_mm = np.array([-10.0, 20.0, 33.33])


def uid(number):
    return pydicom.uid.UID(f"2.25.{number}")


def place_mm(index):
    """Where a voxel (i, j, k) lies."""
    return ORIGIN_mm + SPACING_mm * np.asarray(index)


def ct_slices(shape, decimals=None):
    """Slices of a CT with (i, j, k) voxels, positions rounded if asked for."""
    slices = []
    for k in range(shape[2]):
        item = Dataset()
        item.file_meta = FileMetaDataset()
        item.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        item.file_meta.MediaStorageSOPClassUID = CTImageStorage
        item.file_meta.MediaStorageSOPInstanceUID = uid(100 + k)
        item.SOPClassUID = CTImageStorage
        item.SOPInstanceUID = uid(100 + k)
        item.StudyInstanceUID = uid(1)
        item.SeriesInstanceUID = uid(2)
        item.FrameOfReferenceUID = uid(3)
        for name in ("PatientBirthDate", "PatientSex", "AccessionNumber"):
            setattr(item, name, "")
        item.PatientID = item.StudyID = "1"
        item.PatientName = "Torso^Analytic"
        item.ReferringPhysicianName = item.PositionReferenceIndicator = ""
        item.StudyDate = datetime(2026, 1, 1).date()
        item.StudyTime = datetime(2026, 1, 1).time()
        item.Modality = "CT"
        item.SeriesNumber = 1
        item.InstanceNumber = k + 1
        place = place_mm([0, 0, k])
        item.ImagePositionPatient = (
            place if decimals is None else place.round(decimals)
        ).tolist()
        item.ImageOrientationPatient = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        item.PixelSpacing = [SPACING_mm[1], SPACING_mm[0]]
        item.SliceThickness = SPACING_mm[2]
        item.Rows = shape[1]
        item.Columns = shape[0]
        item.BitsAllocated = item.BitsStored = 16
        item.HighBit = 15
        item.PixelRepresentation = 1
        item.SamplesPerPixel = 1
        item.PhotometricInterpretation = "MONOCHROME2"
        item.PixelData = np.zeros(shape[1::-1], np.int16).tobytes()
        slices.append(item)
    return slices


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


def write_segmentation(path, masks, segments, kind="BINARY", decimals=None):
    """Write masks (i, j, k) as a DICOM segmentation."""
    stack = np.stack([mask.T for mask in masks], axis=-1).astype(np.uint8)
    if kind == "LABELMAP":
        stack = (stack * np.arange(1, len(masks) + 1, dtype=np.uint8)).max(axis=-1)
    elif kind == "FRACTIONAL":
        stack = stack.astype(np.float32)
    file = highdicom.seg.Segmentation(
        ct_slices(masks[0].shape, decimals),
        stack,
        kind,
        segments,
        uid(4),
        2,
        uid(5),
        1,
        "needleforce",
        "test",
        "1",
        "1",
    )
    file.save_as(path)
