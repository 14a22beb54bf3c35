/* version.h: the firmware's version, which every heartbeat tells. */
#ifndef GOLDFIELD_VERSION_H
#define GOLDFIELD_VERSION_H

#define VERSION_MAJOR 0u
#define VERSION_MINOR 1u
#define VERSION_PATCH 0u

#endif
