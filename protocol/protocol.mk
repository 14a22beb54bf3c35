PROTOCOL_OUT := $(BUILD)/protocol
PROTOCOL_HEADERS := $(addprefix $(PROTOCOL_OUT)/,goldfield.h protocol_hash.h parameter_ids.h parameter_table.h counter_ids.h \
    message_table.h link_rates.h)
PROTOCOL_SOURCES := $(addprefix protocol/goldfield_protocol/,goldfield.dbc parameters.toml codegen.py c_tables.py table.py messages.py rates.py)

$(PROTOCOL_OUT)/goldfield.c $(PROTOCOL_HEADERS) &: $(PROTOCOL_SOURCES) $(BUILD)/venv.stamp
	@echo "protocol: generating C packers and tables"
	@$(PYTHON) -m goldfield_protocol.codegen $(PROTOCOL_OUT)
