import os

# before numpy is imported, as the commands have it (`panoexec.__main__`)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
