"""Where Blender sees the joints of FBX files: run by blender_test.cpp as
   blender -b --python blender_joints.py -- OUT.json FILE.fbx...
Each action is posed on its own key frames, at most a hundred of them. Places are Blender's: metres,
Z up."""

import json
import sys

import bpy

MOST_KEYS = 100


def key_frames(action):
    keys = {round(k.co[0], 4) for curve in action.fcurves for k in curve.keyframe_points}
    ordered = sorted(keys)
    return ordered[:: 1 + len(ordered) // MOST_KEYS]


def places(armature):
    world = armature.matrix_world
    found = {bone.name: list((world @ bone.matrix).translation) for bone in armature.pose.bones}
    found.setdefault(armature.name, list(world.translation))
    return found


def posed(scene, armature, frames):
    for frame in frames:
        scene.frame_set(int(frame // 1), subframe=frame % 1)
        yield {"frame": frame, "places": places(armature)}


def read(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.fbx(filepath=path)
    scene = bpy.context.scene
    armatures = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    out = {"rate_hz": scene.render.fps / scene.render.fps_base, "actions": [], "still": []}
    for armature in armatures:
        armature.animation_data_create()
        for action in bpy.data.actions:
            owner, _, take = action.name.partition("|")
            if owner != armature.name:
                continue
            armature.animation_data.action = action
            frames = list(posed(scene, armature, key_frames(action)))
            out["actions"].append({"take": take, "frames": frames})
        armature.animation_data.action = None
        out["still"] += posed(scene, armature, [1])
    return out


out, *files = sys.argv[sys.argv.index("--") + 1 :]
with open(out, "w", encoding="utf-8") as stream:
    json.dump({path: read(path) for path in files}, stream)
