// Runs a navlearn predictor without Python: one row of inputs per line in, corrections out.
//
//   predict predictor.pt < inputs.csv > corrections.csv
//
// The first row sets the state; every row is one step of metadata.time_step_s seconds.

#include <torch/script.h>

#include <iomanip>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: predict predictor.pt < inputs.csv\n";
    return 2;
  }
  torch::NoGradGuard no_gradients;
  torch::jit::Module predictor = torch::jit::load(argv[1]);
  std::cerr << predictor.attr("metadata").toStringRef() << "\n";
  torch::IValue state;
  std::cout << std::setprecision(17);
  for (std::string line; std::getline(std::cin, line);) {
    std::vector<double> row;
    std::stringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) row.push_back(std::stod(cell));
    const torch::Tensor inputs = torch::tensor(row, torch::kFloat64);
    if (state.isNone()) state = predictor.get_method("initial_state")({inputs});
    const auto result = predictor.get_method("step")({inputs, state}).toTuple();
    const torch::Tensor correction = result->elements()[0].toTensor();
    state = result->elements()[1];
    for (int64_t k = 0; k < correction.size(0); ++k)
      std::cout << (k ? "," : "") << correction[k].item<double>();
    std::cout << "\n";
  }
}
