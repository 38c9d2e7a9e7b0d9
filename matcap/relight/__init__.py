"""Renderer of SVBRDF maps: camera, lights and a surface to a picture.

scene.py defines a scene, render.py decides which effects run, render.py is the pipeline.
"""
