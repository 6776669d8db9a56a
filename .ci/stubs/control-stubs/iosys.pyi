from typing import Any

import numpy as np

class NamedSignal(np.ndarray[Any, Any]): ...

def __getattr__(name: str) -> Any: ...
