"""Joints as they stand in a machine file, and the contact in those that have clearance."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    WithJsonSchema,
    model_serializer,
    model_validator,
)

from jointplay.solver.machines import units
from jointplay.solver.machines.fields import (
    ClearanceField,
    Direction,
    Name,
    Point,
    QuantityField,
    RuleError,
    no_default,
)
from jointplay.solver.machines.film import Film
from jointplay.solver.machines.fits import LIMIT_FACTOR, ClassFit, Fit, FitMarker, FitSaid, in_um, new_fit
from jointplay.solver.machines.friction import FRICTION_CHOICES, FRICTION_NUMBERS, DryFriction
from jointplay.solver.machines.parts import Damping, Part
from jointplay.solver.machines.restitution import CONTACT_LAWS, HYSTERESIS


def _check_law(law: object) -> object:
    if not isinstance(law, str) or law not in CONTACT_LAWS:
        *first, last = CONTACT_LAWS
        raise RuleError(f"must be {', '.join(first)} or {last}")
    return law


#: A law of :data:`jointplay.solver.machines.restitution.CONTACT_LAWS`; other packages may add some.
ContactLaw = Annotated[str, BeforeValidator(_check_law), WithJsonSchema({"enum": list(CONTACT_LAWS), "type": "string"})]

#: Exponent of a Hertzian contact of curved surfaces.
HERTZ_EXPONENT = 1.5
#: Least restitution to ask for: below, the hysteresis of some laws exceeds a hundred and grows without bound.
LEAST_RESTITUTION = 0.01
#: Largest radial clearance that can be a limit, m; more is a number in another unit.
LARGEST_LIMIT = 0.1
#: Numbers of the normal force, and those that each law has.
NORMAL_NUMBERS = ("stiffness", "damping", "exponent", "restitution", "hysteresis")
LAW_NUMBERS = {
    "linear": ("stiffness", "damping"),
    "hertz": ("stiffness", "exponent", "hysteresis"),
    **dict.fromkeys(HYSTERESIS, ("stiffness", "exponent", "restitution")),
}


class Contact(DryFriction):
    """Contact of pin and socket, or of a block's corner and a wall, in a joint that has clearance.

    ``law`` of the normal force, with d the penetration: ``linear`` is K d + C d', with ``stiffness`` K [N/m] and
    ``damping`` C [N s/m]; ``hertz`` is K d^n (1 + a d') with ``stiffness`` [N/m^n], ``exponent`` n and ``hysteresis``
    a [s/m]; the others are K d^n (1 + c d'/v0) with c from ``restitution`` and v0 the velocity of approach when the
    contact begins. ``viscous`` [N s/m] acts along the surface beside the dry friction.
    """

    law: ContactLaw = "linear"
    stiffness: Annotated[float, QuantityField(units.STIFFNESS, above=0)] = 1.0e7
    damping: Damping = 300.0
    exponent: Annotated[float, QuantityField(units.RATIO, at_least=1, at_most=3)] | None = None
    restitution: Annotated[float, QuantityField(units.RATIO, at_least=LEAST_RESTITUTION, at_most=1)] | None = None
    hysteresis: Annotated[float, QuantityField(units.HYSTERESIS, at_least=0)] | None = None
    friction: Annotated[float, QuantityField(units.RATIO, at_least=0)] = 0.05
    viscous: Damping = 0.0

    @model_validator(mode="after")
    def _complete(self) -> Contact:
        if self.law != "linear":  # the model is frozen for everybody else
            given = self.model_fields_set
            damping = self.damping if "damping" in given else 0.0
            self.__dict__.update(damping=damping, exponent=self.exponent or HERTZ_EXPONENT)
        return self

    def over(self, defaults: Contact) -> Contact:
        """What this contact says, and `defaults` where it says nothing; numbers of a law do not pass to another law."""
        own = {name: getattr(self, name) for name in self.model_fields_set}
        foreign: set[str] = set()
        if own.get("law", defaults.law) != defaults.law:
            foreign.update(("law", *NORMAL_NUMBERS))
        if self.friction_law != defaults.friction_law and not own.keys().isdisjoint(FRICTION_CHOICES):
            foreign.update(FRICTION_CHOICES)
        inherited = {name: getattr(defaults, name) for name in defaults.model_fields_set if name not in foreign}
        return Contact(**{**inherited, **own})

    def has(self, number: str) -> bool:
        """Whether the laws of this contact know a number that not every law has; True for all other numbers."""
        if number in FRICTION_CHOICES:
            return number in FRICTION_NUMBERS[self.friction_law]
        return number in LAW_NUMBERS[self.law] or number not in NORMAL_NUMBERS


class Defaults(Part):
    """What joints get that say nothing themselves."""

    contact: Contact = Contact()


class WearingJoint(Part):
    """A joint and what is said of its play: radial clearance, or half the play between the walls of a guide.

    ``fit`` says what play the joint has as new, ``limit`` [m] from which it counts as worn out; neither enters the
    equations of motion. ``clearance`` [m] is what the joint has in a simulation that is asked for no other fault.
    """

    kind: str
    links: tuple[Name, Name]
    at: Point
    contact: Contact = Contact()
    fit: Annotated[FitSaid, FitMarker()] | None = None
    limit: Annotated[float, QuantityField(units.LENGTH, above=0, at_most=LARGEST_LIMIT)] | None = None
    clearance: Annotated[float, ClearanceField(above=0)] | None = None

    @model_validator(mode="after")
    def _resolve_fit(self) -> Self:
        try:
            fit = self.new_fit
        except RuleError as error:
            said = self.fit.plain() if isinstance(self.fit, ClassFit) else self.fit
            raise RuleError(error.message(), ("fit",), said) from None
        if self.limit is not None and not self.limit > fit.high:
            raise RuleError(f"must be greater than the joint's play as new, {fit}", ("limit",), in_um(self.limit))
        return self

    @property
    @abstractmethod
    def new_fit(self) -> Fit:
        """Play of the joint as new: that of ``fit``, or the default."""

    @property
    def play_as_new(self) -> tuple[float, float]:
        """Least and greatest clearance of the joint as new, m."""
        fit = self.new_fit
        return fit.low, fit.high

    @property
    def worn_out_from(self) -> float:
        """Clearance from which the joint counts as worn out, m: ``limit``, or ten times the greatest as new."""
        return LIMIT_FACTOR * self.new_fit.high if self.limit is None else self.limit


#: What files could not say once; machines that say nothing of it keep the content key they had then.
_SINCE: dict[str, Any] = dict.fromkeys(("fit", "limit", "clearance", "length", "film"))
_SINCE |= dict.fromkeys(("journal_friction", "height"), 0.0)


class TurningJoint(WearingJoint):
    """A pin in a socket. ``links`` [0] carries the pin unless ``pin`` says otherwise.

    ``at`` [m]; ``pin_radius`` [m], 0 neglects the moment of friction; ``viscous`` [N m s/rad] and ``journal_friction``
    (coefficient: torque over reaction and pin radius, with the friction law of ``contact``) resist relative rotation
    while the joint has no clearance; ``contact`` and the oil of ``film`` count once it has. The size of a class of
    ``fit`` is the pin's diameter.
    """

    kind: Literal["turning"] = "turning"
    pin: Name = Field(default="", json_schema_extra=no_default)
    pin_radius: Annotated[float, QuantityField(units.LENGTH, at_least=0)] = 0.0
    viscous: Annotated[float, QuantityField(units.ROTARY_DAMPING, at_least=0)] = 0.0
    journal_friction: Annotated[float, QuantityField(units.RATIO, at_least=0)] = 0.0
    film: Film | None = None

    @model_serializer(mode="wrap")
    def _leave_out_what_is_not_said(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in write(self).items() if key not in _SINCE or value != _SINCE[key]}

    @property
    def new_fit(self) -> Fit:
        """Play of the joint as new: that of ``fit``, or the default."""
        return new_fit(self.fit, 2 * self.pin_radius, "the pin's diameter: give pin_radius")


class SlidingJoint(WearingJoint, DryFriction):
    """``links`` [0] slides along a line through ``at`` along ``direction`` (unit length), fixed in ``links`` [1].

    ``viscous`` [N s/m] acts along it beside the dry friction, both while the joint has no clearance. One that can have
    says how long its block is, ``length`` [m] along the line with ``at`` in the middle, and how high, ``height`` [m]
    from wall to wall, the size of a class of ``fit``; ``contact`` of its corners counts once it has.
    """

    kind: Literal["sliding"] = "sliding"
    direction: Direction
    viscous: Damping = 0.0
    length: Annotated[float, QuantityField(units.LENGTH, above=0)] | None = None
    height: Annotated[float, QuantityField(units.LENGTH, at_least=0)] = 0.0

    @model_serializer(mode="wrap")
    def _leave_out_numbers_of_other_laws(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written = super()._leave_out_numbers_of_other_laws(write)
        known = self.length is not None
        return {k: v for k, v in written.items() if (k != "contact" or known) and (k not in _SINCE or v != _SINCE[k])}

    @property
    def new_fit(self) -> Fit:
        """Play of the guide as new: that of ``fit``, or the default."""
        return new_fit(self.fit, self.height, "the size from wall to wall: give height")


Joint: TypeAlias = Annotated[TurningJoint | SlidingJoint, Field(discriminator="kind")]
