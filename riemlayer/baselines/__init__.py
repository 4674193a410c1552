"""Rivals and the field itself behind one interface, for tables and comparisons."""

from riemlayer.baselines.base import SupportsExp as SupportsExp
from riemlayer.baselines.base import SupportsLog as SupportsLog
from riemlayer.baselines.base import SupportsMesh as SupportsMesh
from riemlayer.baselines.base import SupportsPoints as SupportsPoints
from riemlayer.baselines.heat import Heat as Heat
from riemlayer.baselines.mesh import MeshHeat as MeshHeat
from riemlayer.baselines.mesh import MeshTracer as MeshTracer
from riemlayer.baselines.neural import Neural as Neural
from riemlayer.baselines.projection import Projection as Projection
from riemlayer.baselines.truth import TrueLog as TrueLog
from riemlayer.baselines.walking import Walking as Walking
