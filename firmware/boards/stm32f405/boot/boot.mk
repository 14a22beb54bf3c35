# The boot loader: an image of its own in sector 0. It is compiled for size and without the floating-point unit, which is off when it runs.
BOOT_OUT := $(BUILD)/boot
BOOT_CPU := -mcpu=cortex-m4 -mthumb -mfloat-abi=soft
BOOT_FLAGS := $(BOOT_CPU) -Os -g -ffunction-sections -fdata-sections -fno-common -fstack-usage -fcallgraph-info=su -MMD -MP \
	-DBLAKE2_NO_UNROLLING=1 -Ifirmware
BOOT_SOURCES := $(STM32)/boot/boot.c $(STM32)/wait.c $(STM32)/flash_operation.c \
	$(addprefix firmware/core/,boot/image.c boot/select.c storage/crc32.c) $(THIRD_PARTY_SOURCES)
BOOT_OBJECTS := $(BOOT_SOURCES:%.c=$(BOOT_OUT)/%.o)
BOOT_IMAGE := $(BOOT_OUT)/boot.elf

$(THIRD_PARTY_SOURCES:%.c=$(BOOT_OUT)/%.o): private BOOT_FLAGS += -w

$(BOOT_OBJECTS): $(BOOT_OUT)/%.o: %.c $(BUILD)/arm-tools.stamp $(STM32)/boot/boot.mk
	@mkdir -p $(@D)
	@$(ARM)gcc $(C_STANDARD) $(BOOT_FLAGS) -c -o $@ $<

$(BOOT_IMAGE): $(BOOT_OBJECTS) $(STM32)/boot/boot.ld
	@echo "firmware: $@"
	@$(ARM)gcc $(BOOT_CPU) -nostartfiles --specs=nano.specs -Wl,--gc-sections -Wl,--fatal-warnings -T $(STM32)/boot/boot.ld \
		-Wl,-Map=$(@:.elf=.map) -o $@ $(BOOT_OBJECTS)
	@$(ARM)objcopy -O binary $@ $(@:.elf=.bin)

-include $(BOOT_OBJECTS:.o=.d)
