"""What Blender makes of curves with tangents: run by fbx_losses_test.cpp as
   blender -b --python blender_curves.py -- IN.json OUT.json
IN holds a list of curves, each a list of keys [frame, value, slope behind, slope before, weight
behind, weight before], slopes per frame and weights as shares of the way to the neighbour; OUT the
values of each curve on its whole frames."""

import json
import sys

import bpy


def evaluated(keys):
    action = bpy.data.actions.new("curves")
    curve = action.fcurves.new("location")
    curve.keyframe_points.add(len(keys))
    for k, (frame, value, behind, before, weight_behind, weight_before) in enumerate(keys):
        point = curve.keyframe_points[k]
        point.co = (frame, value)
        point.interpolation = "BEZIER"
        point.handle_left_type = point.handle_right_type = "FREE"
        way_behind = weight_behind * (keys[k + 1][0] - frame) if k + 1 < len(keys) else 0.1
        way_before = weight_before * (frame - keys[k - 1][0]) if k > 0 else 0.1
        point.handle_right = (frame + way_behind, value + way_behind * behind)
        point.handle_left = (frame - way_before, value - way_before * before)
    first, last = int(keys[0][0]), int(keys[-1][0])
    return [curve.evaluate(frame) for frame in range(first, last + 1)]


asked, out = sys.argv[sys.argv.index("--") + 1 :]
with open(asked, encoding="utf-8") as stream:
    curves = json.load(stream)
with open(out, "w", encoding="utf-8") as stream:
    json.dump([evaluated(keys) for keys in curves], stream)
