"""Batch capture: every photograph of a folder to a material; failures are recorded and reported.

`samples` lists the photographs and settings, `work` is a worker's job and the files that hold all
state, `worker_pool` the worker processes, `run` schedules the jobs, `overview` is the index page.
"""
