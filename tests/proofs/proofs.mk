# Proofs: Frama-C's Eva on what reads bytes of others. tests/proofs/README.md tells what is proven and what is assumed.
PROOFS ?=

$(BUILD)/frama-c.stamp:
	@mkdir -p $(BUILD)
	@$(call need,frama-c,frama-c-base)
	@touch $@

proofs: $(BUILD)/frama-c.stamp $(BUILD)/venv.stamp $(PROTOCOL_HEADERS) ## Prove frames, queue, parameters, storage, boot loader and update: no undefined behaviour (minutes; PROOFS="storage")
	@$(PYTHON) -m tests.proofs.run $(PROOFS)

.PHONY: proofs
