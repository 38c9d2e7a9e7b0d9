"""Maps in a scene: camera, lights and a surface to a picture.

Read scene.py for what a scene is, plan.py for which effects run, render.py for the way through.
"""
