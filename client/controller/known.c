// SPDX-License-Identifier: MIT
#include "known.h"

#include <stddef.h>

static const struct known_device table[] = {
    {0x046d, 0xc603, KNOWN_SPACEMOUSE, "SpaceMouse Plus XT"},
    {0x046d, 0xc605, KNOWN_SPACEMOUSE, "CADman"},
    {0x046d, 0xc606, KNOWN_SPACEMOUSE, "SpaceMouse Classic"},
    {0x046d, 0xc621, KNOWN_SPACEMOUSE, "Spaceball 5000"},
    {0x046d, 0xc623, KNOWN_SPACEMOUSE, "SpaceTraveler"},
    {0x046d, 0xc625, KNOWN_SPACEMOUSE, "SpacePilot"},
    {0x046d, 0xc626, KNOWN_SPACEMOUSE, "SpaceNavigator"},
    {0x046d, 0xc627, KNOWN_SPACEMOUSE, "SpaceExplorer"},
    {0x046d, 0xc628, KNOWN_SPACEMOUSE, "SpaceNavigator for Notebooks"},
    {0x046d, 0xc629, KNOWN_SPACEMOUSE, "SpacePilot Pro"},
    {0x046d, 0xc62b, KNOWN_SPACEMOUSE, "SpaceMouse Pro"},
    {0x256f, 0xc62e, KNOWN_SPACEMOUSE, "SpaceMouse Wireless (cable)"},
    {0x256f, 0xc62f, KNOWN_SPACEMOUSE, "SpaceMouse Wireless (receiver)"},
    {0x256f, 0xc631, KNOWN_SPACEMOUSE, "SpaceMouse Pro Wireless (cable)"},
    {0x256f, 0xc632, KNOWN_SPACEMOUSE, "SpaceMouse Pro Wireless (receiver)"},
    {0x256f, 0xc633, KNOWN_SPACEMOUSE, "SpaceMouse Enterprise"},
    {0x256f, 0xc635, KNOWN_SPACEMOUSE, "SpaceMouse Compact"},
    {0x256f, 0xc636, KNOWN_SPACEMOUSE, "SpaceMouse Module"},
    {0x256f, 0xc638, KNOWN_SPACEMOUSE, "SpaceMouse Pro Wireless BT (cable)"},
    {0x256f, 0xc63a, KNOWN_SPACEMOUSE, "SpaceMouse Wireless BT (cable)"},
    {0x256f, 0xc652, KNOWN_SPACEMOUSE, "3Dconnexion universal receiver"},
    {0x077d, 0x0410, KNOWN_POWERMATE, "Griffin PowerMate"},
    {0x077d, 0x04aa, KNOWN_POWERMATE, "Griffin SoundKnob"},
};

const struct known_device *known_find(uint16_t vendor, uint16_t product)
{
    static const struct known_device none = {0, 0, KNOWN_NOT, ""};
    for (size_t i = 0; i < sizeof table / sizeof *table; i++)
        if (table[i].vendor == vendor && table[i].product == product) return &table[i];
    return &none;
}

// Byte 0: the button; byte 1: counts of the dial; the rest: the light's state.
const uint8_t known_powermate_descriptor[] = {
    0x05, 0x01, 0x09, 0x08, 0xa1, 0x01, // multi-axis
    0x05, 0x09, 0x09, 0x01, 0x15, 0x00, 0x25,
    0x01, 0x75, 0x01, 0x95, 0x01, 0x81, 0x02, // button
    0x95, 0x07, 0x81, 0x03,                   // padding
    0x05, 0x01, 0x09, 0x37, 0x15, 0x80, 0x25,
    0x7f, 0x75, 0x08, 0x95, 0x01, 0x81, 0x06, // dial
    0x95, 0x04, 0x81, 0x03, 0xc0,
};
const uint32_t known_powermate_size = sizeof known_powermate_descriptor;
