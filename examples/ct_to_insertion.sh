#!/bin/sh
# From a CT to a watched insertion, on a torso and an arm that are simulated.
# Your own: leave out the first command, name your files, and an arm for sim:...
# Not a medical device.
set -e
needleforce simulate torso -o patient
needleforce plan --ct patient/ct.nii.gz --labels patient/labels.nii.gz --target lesion -o plan
needleforce touch sim:plan/plan.json --landmarks patient/landmarks.mrk.json -o touches.json
needleforce register --plan plan/plan.json --landmarks patient/landmarks.mrk.json --touches touches.json -o plan/plan.json
needleforce live sim:plan/plan.json --plan plan/plan.json --tare 13
