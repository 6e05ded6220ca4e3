add_test(NAME slurm COMMAND ${CMAKE_SOURCE_DIR}/deploy/cluster/with_slurm
  ${CMAKE_CURRENT_LIST_DIR}/slurm.sh ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(slurm PROPERTIES LABELS cluster SKIP_RETURN_CODE 77)
