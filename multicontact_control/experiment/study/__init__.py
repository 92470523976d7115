"""
Studies: a grid of jobs, each run once and kept, one table of what came out, and one page.

A job is named by the hash of everything that decides its outcome, so that an interrupted study
goes on where it stopped and a changed configuration is run again. What carries the jobs out is an
`Executor`: processes of this machine, or a Dask cluster.
"""
