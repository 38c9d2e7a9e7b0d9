"""Batch capture: every photograph of a folder to a material; failures are recorded and reported.

`run` schedules the jobs. `input_folder` lists the photographs, `identity` hashes what a material is
made from, `record` and `workspace` are the files that hold all state, `work` is a worker's job,
`worker_pool` the worker processes, `overview` the index page.
"""
