/* parameters.h: the numbers that a user may set on a board: typed, checked against their range, and loaded from the
 * page in flash. Which parameters there are is told by protocol/goldfield_protocol/parameters.toml, from which
 * parameter_ids.h (the names PARAMETER_...) and parameter_table.h are generated; docs/parameters.md is the same as a
 * page to read.
 *
 * The calls, in the order in which they are made:
 *   1. parameters_init() gives every parameter its default;
 *   2. parameters_load() takes over what the stored page holds;
 *   3. parameters_unsigned() and parameters_float() are the application's own reading;
 *   4. parameters_get(), parameters_set() and parameters_next() serve a host: value, change and description;
 *      parameters_entry() goes over the whole table, for who keeps all of it (parameter_set.h).
 *
 * A value is 32 bits of one kind: unsigned, signed or float (IEEE 754, single precision). Both ends of a range are
 * allowed; a float that is not a number is out of range. What fits together only with other parameters (a slot with
 * the number of slots, a code with the degree) is judged by the module that uses it.
 *
 * Every board keeps every parameter, also those that its role does not use: one page fits all boards.
 * parameters_next() tells only those that a role uses.
 *
 * The stored page is little-endian: magic u32 "GFP1", count u16, CRC-16/CCITT-FALSE of the entries u16, then for each
 * entry id u16, kind u16, value u32. It is trusted only if its magic, its length and its CRC are right, and each entry
 * still passes the checks of parameters_set().
 *
 * Contexts: all calls come from main. An interrupt may read a value while main sets it, for a value is one word.
 * Memory: parameters_t takes 3.3 kB of RAM; the table lies in flash. Cost: a search passes over at most 43 entries,
 * which is the bound of every call on one id.
 */
#ifndef GOLDFIELD_PARAMETERS_H
#define GOLDFIELD_PARAMETERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "parameter_ids.h"

/* How the 32 bits of a value are read; the numbers are those of PARAM_VALUE and of the stored page. */
typedef enum { PARAMETER_UNSIGNED = 0, PARAMETER_SIGNED = 1, PARAMETER_FLOAT = 2 } parameter_kind_t;

/* What became of a request; the numbers are those of PARAM_VALUE. No parameter is read-only today. */
typedef enum {
    PARAMETER_OK = 0,
    PARAMETER_UNKNOWN = 1,
    PARAMETER_OUT_OF_RANGE = 2,
    PARAMETER_WRONG_KIND = 3,
    PARAMETER_READ_ONLY = 4,
    PARAMETER_LOCKED = 5 /* It is judged by who lets a host change a parameter (services/access.h). */
} parameter_status_t;

/* A value as it travels: its kind, and its 32 bits. */
typedef struct {
    uint8_t kind; /* A parameter_kind_t, or any other number that came over a link. */
    uint32_t bits;
} parameter_value_t;

/* One parameter of the table: rows of elements with successive ids, each row stride ids after the one before. */
typedef struct {
    uint16_t first_id; /* Id of the first element of the first row. */
    uint8_t kind;      /* parameter_kind_t */
    uint8_t at_start;  /* 1: a change acts after the next reset only. */
    uint8_t roles;     /* Bit 1 << hal_role_t is set for each role that uses the parameter. */
    uint8_t elements;  /* Elements of a row. */
    uint8_t rows;      /* Rows. */
    uint8_t stride;    /* Ids from one row to the next; 0 for a single row. */
    uint8_t excluded;  /* An unsigned value of the range that is refused all the same; 0: there is none. */
    uint32_t minimum;  /* Smallest value, as 32 bits of the kind. */
    uint32_t maximum;  /* Largest value, as 32 bits of the kind. */
    uint32_t initial;  /* Default of the first element, as 32 bits of the kind. */
    const char *text;  /* Name and, behind a space, the unit if there is one. */
} parameter_entry_t;

/* The values of all elements, in the order of the table. */
typedef struct {
    uint32_t bits[PARAMETERS_COUNT];
    uint32_t seal; /* What they make together, which each change keeps up. */
} parameters_t;

typedef enum {
    PARAMETERS_PAGE_LOADED = 0, /* The page was good; single entries may have been refused. */
    PARAMETERS_PAGE_EMPTY = 1,  /* The flash is erased (all ones in the magic): no error, the defaults hold. */
    PARAMETERS_PAGE_BAD = 2     /* Magic, length or CRC are wrong: the page is ignored as a whole. */
} parameters_page_t;

/* Give every parameter its default. */
void parameters_init(parameters_t *parameters);

/* Set parameters from a stored page of size bytes. Entries that are unknown, out of range or of the wrong kind are
 * skipped and counted in *refused. A page that is not PARAMETERS_PAGE_LOADED changes nothing. The bound is size / 8
 * entries.
 * Returns what became of the page. */
parameters_page_t parameters_load(parameters_t *parameters, const uint8_t *page, size_t size, uint32_t *refused);

/* Read an unsigned parameter for the application's own use.
 * Returns its value; 0 for an id that does not exist or has another kind. */
uint32_t parameters_unsigned(const parameters_t *parameters, uint32_t id);

/* Read a float parameter for the application's own use.
 * Returns its value; 0 for an id that does not exist or has another kind. */
float parameters_float(const parameters_t *parameters, uint32_t id);

/* Read any parameter into *value.
 * Returns PARAMETER_OK, or PARAMETER_UNKNOWN with an unsigned 0 in *value. */
parameter_status_t parameters_get(const parameters_t *parameters, uint32_t id, parameter_value_t *value);

/* Set a parameter; if it is refused it stays as it was.
 * Returns PARAMETER_OK, PARAMETER_UNKNOWN, PARAMETER_WRONG_KIND or PARAMETER_OUT_OF_RANGE. */
parameter_status_t parameters_set(parameters_t *parameters, uint32_t id, parameter_value_t value);

/* Returns whether all values are as they were set: a stray write, or a bit that has flipped in memory, changes one
 * without its seal. Costs about 13 instructions a value. */
bool parameters_intact(const parameters_t *parameters);

/* Returns entry index of the table, of any role, a constant; NULL behind the last one. */
const parameter_entry_t *parameters_entry(uint32_t index);

/* Find the next parameter of the table: the first one whose first_id is at least id and that the role uses.
 * Returns the entry, a constant; NULL if there is none. */
const parameter_entry_t *parameters_next(uint32_t id, uint32_t role);

#endif
