PROTOCOL_OUT := $(BUILD)/protocol
PROTOCOL_HEADERS := $(PROTOCOL_OUT)/goldfield.h $(PROTOCOL_OUT)/protocol_hash.h

$(PROTOCOL_OUT)/goldfield.c $(PROTOCOL_HEADERS) &: protocol/goldfield_protocol/goldfield.dbc protocol/goldfield_protocol/codegen.py $(BUILD)/venv.stamp
	@echo "protocol: generating C packers"
	@$(PYTHON) -m goldfield_protocol.codegen $(PROTOCOL_OUT)
