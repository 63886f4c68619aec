"""Arrays of each kind of number."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]
#: Of either precision.
AnyComplexArray = NDArray[np.complexfloating]
#: Of records, whose fields have names.
StructuredArray = NDArray[Any]
