// Evaluate a policy of rkhs_ros in C++17, without other libraries. `rkhs export RUN policy.txt` writes this header and
// the policy. A call allocates no memory, so a real-time loop may use it:
//
//   rkhs::Policy policy("policy.txt");
//   policy.reset();                                           // at the start of each episode
//   const std::vector<double>& action = policy(observation);  // at each step; clipped to the bounds
#pragma once
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace rkhs {
class Policy {
 public:
  // Read a policy; throws std::runtime_error if the file is missing, incomplete, damaged or of another version.
  explicit Policy(const std::string& path) : path_(path), file_(path) {
    if (word() != "rkhs_policy" || word() != "1") throw std::runtime_error(path_ + ": expected 'rkhs_policy 1'");
    columns_ = count(), history_ = count(), repeat_ = count(), low_ = numbers(), high_ = numbers();
    for (double angle : numbers()) angles_.push_back(whole(angle, columns_));
    turns_ = numbers();
    for (std::size_t i = 0; i < columns_; ++i)
      if (std::find(angles_.begin(), angles_.end(), i) == angles_.end()) rest_.push_back(i);
    degree_ = count(), factors_ = numbers(), scales_ = numbers(), constant_ = number();
    for (std::size_t left = count(); left > 0; --left) terms_.push_back({kind(word()), numbers()});
    centres_ = numbers(), weights_ = numbers();
    action_.resize(low_.size()), mean_.resize(low_.size()), stack_.resize(terms_.size());
    entry_ = columns_ + angles_.size() + (history_ > 1 ? low_.size() : 0);
    window_.resize(whole(static_cast<double>(history_) * static_cast<double>(entry_), most)), factored_.resize(window_.size() + 1, constant_);
    point_.resize(degree_ ? scales_.size() : window_.size());
    if (!fits()) throw std::runtime_error(path_ + ": the sizes do not match");
    for (double factor : factors_) whole(factor, factored_.size());
    file_.close();
  }

  void reset() {
    steps_ = 0;
    std::fill(mean_.begin(), mean_.end(), 0.0);
  }

  // Return the action; throws std::invalid_argument if the observation has another size or is not finite.
  const std::vector<double>& operator()(const std::vector<double>& observation) {
    if (observation.size() != columns_) throw std::invalid_argument("observation: wrong size");
    if (!std::all_of(observation.begin(), observation.end(), [](double each) { return std::isfinite(each); }))
      throw std::invalid_argument("observation: expected finite numbers");
    const bool begins = steps_ == 0, decides = begins || steps_ == repeat_;
    if (decides) observe(observation, begins), decide();
    steps_ = decides ? 1 : steps_ + 1;
    return action_;
  }

 private:
  enum Kind { rbf, polynomial, linear, sum, product };
  struct Term {
    Kind kind;
    std::vector<double> parameters;
  };

  // Return whether the sizes match, so that no call leaves a list.
  bool fits() const {
    const std::size_t n = low_.size(), d = point_.size(), m = weights_.size() / std::max<std::size_t>(n, 1);
    std::size_t depth = 0;  // of the stack
    for (const Term& term : terms_) {
      const std::size_t size = term.parameters.size(), sizes[] = {size == 1 ? 1 : d, 2, 2 * d, 0, 0};
      if (size != sizes[term.kind] || (term.kind >= sum && depth < 2)) return false;
      depth = term.kind < sum ? depth + 1 : depth - 1;
    }
    return depth == 1 && history_ > 0 && repeat_ > 0 && high_.size() == n && turns_.size() == angles_.size() &&
           factors_.size() == degree_ * scales_.size() && weights_.size() == m * n && centres_.size() == m * d;
  }

  // Shift the window and append the observation with the unclipped action before it; fill the window at the start.
  void observe(const std::vector<double>& observation, bool begins) {
    std::copy(window_.begin() + static_cast<std::ptrdiff_t>(entry_), window_.end(), window_.begin());
    double *last = &window_[(history_ - 1) * entry_], *next = last;
    for (std::size_t i = 0; i < angles_.size(); ++i, ++next) {
      const double angle = observation[angles_[i]] * (2.0 * std::acos(-1.0) / turns_[i]);
      next[0] = std::sin(angle), next[angles_.size()] = std::cos(angle);
    }
    next += angles_.size();
    for (std::size_t column : rest_) *next++ = observation[column];
    if (history_ > 1) std::copy(mean_.begin(), mean_.end(), next);
    for (std::size_t age = 0; begins && age + 1 < history_; ++age) std::copy_n(last, entry_, &window_[age * entry_]);
  }

  void decide() {
    std::copy(window_.begin(), window_.end(), degree_ ? factored_.begin() : point_.begin());
    if (degree_) point_ = scales_;
    for (std::size_t i = 0; i < degree_ * point_.size(); ++i)
      point_[i / degree_] *= factored_[static_cast<std::size_t>(factors_[i])];
    const std::size_t n = mean_.size(), d = point_.size();
    std::fill(mean_.begin(), mean_.end(), 0.0);
    for (std::size_t i = 0; i * n < weights_.size(); ++i) {
      const double value = kernel(&centres_[i * d]);
      for (std::size_t j = 0; j < n; ++j) mean_[j] += value * weights_[i * n + j];
    }
    for (std::size_t j = 0; j < n; ++j) action_[j] = std::min(std::max(mean_[j], low_[j]), high_[j]);
  }

  // Return the kernel of the point with a centre, whose terms are in postfix order.
  double kernel(const double* centre) {
    double* top = stack_.data();
    for (const Term& term : terms_) {
      if (term.kind < sum)
        *top++ = leaf(term.kind, term.parameters, centre);
      else
        --top, top[-1] = term.kind == sum ? top[-1] + top[0] : top[-1] * top[0];
    }
    return stack_[0];
  }

  double leaf(Kind kind, const std::vector<double>& p, const double* y) const {
    const std::size_t d = point_.size();
    double total = 0.0;
    for (std::size_t j = 0; j < d; ++j) {
      if (kind == rbf) total += std::pow((point_[j] - y[j]) / p[p.size() == 1 ? 0 : j], 2);
      if (kind == linear) total += (point_[j] - p[j]) / p[d + j] * ((y[j] - p[j]) / p[d + j]);
      if (kind == polynomial) total += point_[j] * y[j];
    }
    if (kind == polynomial) return std::pow(total + p[0], p[1]);
    return kind == rbf ? std::exp(-0.5 * total) : 1.0 + total;
  }

  Kind kind(const std::string& name) const {
    const std::vector<std::string> names = {"rbf", "polynomial", "linear", "sum", "product"};
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) throw std::runtime_error(path_ + ": unknown kernel " + name);
    return static_cast<Kind>(found - names.begin());
  }

  std::string word() {
    std::string text;
    if (!(file_ >> text)) throw std::runtime_error(path_ + ": expected a whole policy file");
    return text;
  }
  double number() {  // in any locale
    const std::string text = word();
    double value = 0.0;
    const auto read = std::from_chars(text.data(), text.data() + text.size(), value);
    if (read.ec != std::errc() || *read.ptr) throw std::runtime_error(path_ + ": expected a number, got " + text);
    return value;
  }
  std::size_t whole(double value, std::size_t end) const {
    if (!(value >= 0.0 && value < static_cast<double>(end) && value == std::floor(value)))
      throw std::runtime_error(path_ + ": expected a whole number below " + std::to_string(end));
    return static_cast<std::size_t>(value);
  }
  std::size_t count() { return whole(number(), most); }
  std::vector<double> numbers() {  // their count, then the numbers
    std::vector<double> values;
    for (std::size_t left = count(); left > 0; --left) values.push_back(number());
    return values;
  }

  static constexpr std::size_t most = 100000000;  // numbers in a list
  std::string path_;
  std::ifstream file_;
  std::size_t columns_, history_, repeat_, degree_, entry_, steps_ = 0;
  std::vector<std::size_t> angles_, rest_;
  std::vector<double> low_, high_, turns_, factors_, scales_, centres_, weights_;
  std::vector<double> window_, factored_, point_, mean_, action_, stack_;
  std::vector<Term> terms_;
  double constant_;
};

}  // namespace rkhs
