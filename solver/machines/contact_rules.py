"""Which numbers of a contact go with which law."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from jointplay.solver.machines.content import MachineContent
from jointplay.solver.machines.fields import RuleError
from jointplay.solver.machines.joints import LAW_NUMBERS, NORMAL_NUMBERS, Contact
from jointplay.solver.machines.restitution import remark

__all__ = ["contact_breaches", "refuse_units_of_another_law", "restitution_remarks"]

_Breach = tuple[str, object, str]


def contact_breaches(defaults: Contact, contacts: Mapping[str, Contact]) -> Iterator[_Breach]:
    """Broken rules as (path, value, rule).

    Parameters
    ----------
    defaults : Contact
        May be incomplete: what it leaves out, every joint can say itself.
    contacts : mapping of str to Contact
        Of the joints, over the defaults, by path.
    """
    yield from _foreign("defaults.contact", defaults)
    for path, contact in contacts.items():
        yield from _foreign(path, contact)
        if contact.law == "linear":
            continue
        for name in LAW_NUMBERS[contact.law]:
            said = name == "exponent" or name in contact.model_fields_set
            if not said or getattr(contact, name) is None:
                rule = f"is missing; law {contact.law} needs it"
                if defaults.law == contact.law and "law" in defaults.model_fields_set:
                    # The law was written there, perhaps nowhere else; a joint may still complete it.
                    yield f"defaults.contact.{name}", None, f"{rule}, and {path.removesuffix('.contact')} has none"
                yield f"{path}.{name}", None, rule


def _foreign(path: str, contact: Contact) -> Iterator[_Breach]:
    for name in NORMAL_NUMBERS:
        value = getattr(contact, name)
        # A damping of 0 says nothing: it is what a contact of another law is written with.
        if value and not contact.has(name) and name in contact.model_fields_set:
            rule = f"law {contact.law} has no {name}, it has {_listed(LAW_NUMBERS[contact.law])}"
            yield f"{path}.{name}", value, rule


def restitution_remarks(
    machine: MachineContent, joints: Iterable[str], values: Mapping[str, float] | None = None
) -> list[str]:
    """One line for each contact whose law returns a restitution far from the one it is asked for.

    Parameters
    ----------
    machine : MachineContent
    joints : iterable of str
        Turning joints to look at.
    values : mapping of str to float, optional
        Numbers by path that differ from the machine file.
    """
    lines = []
    for joint in joints:
        contact = getattr(machine.joints[joint], "contact", None)
        if isinstance(contact, Contact) and contact.restitution is not None:
            asked = (values or {}).get(f"joints.{joint}.contact.restitution", contact.restitution)
            line = remark(contact.law, asked)
            lines += [f"joint {joint}: {line}"] if line else []
    return lines


def _listed(names: tuple[str, ...]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]])


def refuse_units_of_another_law(tree: object) -> None:
    """Refuse a stiffness with a unit of force over length where the law makes it N/m^n.

    Parameters
    ----------
    tree : object
        A machine as it was read, of any shape.

    Raises
    ------
    RuleError
        Points at the stiffness.
    """
    default = _law(_at(tree, "defaults", "contact"))
    places: list[tuple[str, ...]] = [("defaults", "contact")]
    joints = _at(tree, "joints")
    places += [("joints", str(name), "contact") for name in joints] if isinstance(joints, Mapping) else []
    for place in places:
        contact = _at(tree, *place)
        if (_law(contact) or default or "linear") == "linear":
            continue
        stiffness = _at(contact, "stiffness")
        if isinstance(stiffness, str) and not _is_number(stiffness):
            rule = "must be a plain number: with this law it is in N/m^n, n the exponent"
            raise RuleError(rule, (*place, "stiffness"), stiffness)


def _at(tree: object, *keys: str) -> object:
    for key in keys:
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def _law(contact: object) -> object:
    return _at(contact, "law")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
