# The hot path of goldfield.locate in C; without it the host computes the same with NumPy, slower. How it is compiled
# stands in setup.py, for pip and for make alike.
LOCATE_LIBRARY := host/goldfield/locate/kernel/built/libgf_locate.so
HOST_LIBRARIES += $(LOCATE_LIBRARY)

$(LOCATE_LIBRARY): $(wildcard host/goldfield/locate/kernel/*.[ch]) setup.py | $(BUILD)/venv.stamp
	@echo "location: $@"
	@rm -f $@
	@CFLAGS="$(C_STANDARD)" $(PYTHON) setup.py -q build_ext --inplace --force && test -f $@

# The block filter of the sensor, for the host (goldfield.track.blocks.kernel); the same command makes both.
BANK_LIBRARY := host/goldfield/track/blocks/kernel/built/libgf_bank.so
HOST_LIBRARIES += $(BANK_LIBRARY)

$(BANK_LIBRARY): host/goldfield/locate/kernel/linear.c host/goldfield/locate/kernel/linear.h $(wildcard host/goldfield/track/blocks/kernel/*.[ch] firmware/core/track/*.[ch] firmware/core/math/*.[ch]) | $(LOCATE_LIBRARY)
	@echo "block filter: $@"
	@rm -f $@
	@CFLAGS="$(C_STANDARD)" $(PYTHON) setup.py -q build_ext --inplace --force && test -f $@
