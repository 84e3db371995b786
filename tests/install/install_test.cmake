function(run)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE result)
  if(NOT result EQUAL 0)
    message(FATAL_ERROR "failed with ${result}: ${ARGN}")
  endif()
endfunction()

file(REMOVE_RECURSE ${WORK_DIR})
run(${CMAKE_COMMAND} --install ${BINARY_DIR} --prefix ${WORK_DIR}/prefix)
run(${CMAKE_COMMAND} -S ${SOURCE_DIR}/outside -B ${WORK_DIR}/build -DCMAKE_PREFIX_PATH=${WORK_DIR}/prefix -DCMAKE_BUILD_TYPE=Release)
run(${CMAKE_COMMAND} --build ${WORK_DIR}/build)
run(${WORK_DIR}/prefix/bin/shale compile ${MODEL} --render 24x16 -o ${WORK_DIR}/small.shale)
run(${WORK_DIR}/build/outside ${WORK_DIR}/small.shale)
run(${WORK_DIR}/build/outside_c)
# The layer is found by its manifest, and finds its library.
run(${CMAKE_COMMAND} -E env VK_LAYER_PATH=${WORK_DIR}/prefix/share/vulkan/explicit_layer.d VK_INSTANCE_LAYERS=VK_LAYER_SHALE_data_graph
  SHALE_LAYER_CACHE=off ${BINARY_DIR}/tests/layer/layer_example)
