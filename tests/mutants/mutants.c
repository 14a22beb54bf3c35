/* The state that all instrumented sources share: see mutants.h. GF_COUNT is one more than the last mutant. */
int gf_mutant = 0;
unsigned char gf_infected[GF_COUNT];

extern const gf_kind_t __start_gf_kinds[], __stop_gf_kinds[]; /* Made by the linker. */

int gf_kinds_count(void) {
    return (int)(__stop_gf_kinds - __start_gf_kinds);
}

const gf_kind_t *gf_kinds(void) {
    return __start_gf_kinds;
}
