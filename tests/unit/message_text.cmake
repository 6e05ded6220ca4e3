prt_test(message_text SOURCES unit/message_text.c LIBS relight_message_text LABELS unit)
