# cJSON makes the JSON of a GLB.
find_library(CJSON_LIBRARY cjson REQUIRED)
target_link_libraries(prt_formats PRIVATE ${CJSON_LIBRARY})
