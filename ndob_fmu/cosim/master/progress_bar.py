"""tqdm with a lock of this process only.

Its own lock is a semaphore of the system. From Python 3.14 on, a command that ends by `os._exit` leaves it behind, with
a warning of multiprocessing.
"""

from threading import RLock

from tqdm import tqdm

__all__ = ["tqdm"]

tqdm.set_lock(RLock())
