#pragma once

#include <fmt/format.h>
#include <zlib.h>

#include <bit>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <variant>
#include <vector>

/// FBX 7 files with animation curves, binary and ASCII: the tests' own writer, sharing nothing with
/// the readers but the format.
namespace limber::test {

struct FbxOut {
  using Value =
      std::variant<std::int32_t, std::int64_t, double, std::string, std::vector<std::int64_t>,
                   std::vector<std::int32_t>, std::vector<float>>;
  std::string name;
  std::vector<Value> values = {};
  std::vector<FbxOut> children = {};
};

// ---- ASCII

template <class T>
std::string ascii_array(const std::vector<T>& numbers, bool as_bits) {
  std::string out = fmt::format("*{} {{\n\ta: ", numbers.size());
  for (std::size_t k = 0; k < numbers.size(); ++k) {
    if (k > 0) out += ",";
    if constexpr (std::is_same_v<T, float>) {
      if (as_bits) {
        out += fmt::format("{}", std::bit_cast<std::int32_t>(numbers[k]));
        continue;
      }
    }
    out += fmt::format("{}", numbers[k]);
  }
  return out + "\n}";
}

inline std::string ascii_node(const FbxOut& node) {
  std::string out = node.name + ": ";
  for (std::size_t k = 0; k < node.values.size(); ++k) {
    if (k > 0) out += ", ";
    out += std::visit(
        [&]<class T>(const T& value) -> std::string {
          if constexpr (std::is_arithmetic_v<T>) return fmt::format("{}", value);
          if constexpr (std::is_same_v<T, std::string>) return '"' + value + '"';
          if constexpr (!std::is_arithmetic_v<T> && !std::is_same_v<T, std::string>) {
            return ascii_array(value, node.name == "KeyAttrDataFloat");
          }
        },
        node.values[k]);
  }
  if (!node.children.empty()) {
    out += " {\n";
    for (const FbxOut& child : node.children) out += ascii_node(child);
    out += "}";
  }
  return out + "\n";
}

inline std::string ascii_fbx(const std::vector<FbxOut>& nodes) {
  std::string out = "; FBX 7.4.0 project file\n";
  for (const FbxOut& node : nodes) out += ascii_node(node);
  return out;
}

// ---- binary

struct FbxBinary {
  std::uint32_t version = 7400;  ///< from 7500 on offsets have 64 bits
  bool deflate = false;          ///< arrays

  std::string write(const std::vector<FbxOut>& nodes) const {
    std::string out("Kaydara FBX Binary  \0\x1A\0", 23);
    put(out, version);
    for (const FbxOut& node : nodes) put_node(out, node);
    return out + end_of_list() + std::string(160, '\0');
  }

 private:
  template <class T>
  static void put(std::string& out, T value) {
    out.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  void put_offset(std::string& out, std::size_t at, std::size_t value) const {
    if (version >= 7500) {
      std::memcpy(out.data() + at, &value, 8);
    } else {
      const auto narrow = static_cast<std::uint32_t>(value);
      std::memcpy(out.data() + at, &narrow, 4);
    }
  }
  std::size_t offset_size() const { return version >= 7500 ? 8 : 4; }
  std::string end_of_list() const { return std::string(3 * offset_size() + 1, '\0'); }

  template <class T>
  void put_array(std::string& out, char type, const std::vector<T>& numbers) const {
    out += type;
    put(out, static_cast<std::uint32_t>(numbers.size()));
    const uLong size = numbers.size() * sizeof(T);
    std::string bytes(reinterpret_cast<const char*>(numbers.data()), size);
    if (deflate) {
      uLongf made = compressBound(size);
      bytes.resize(made);
      compress(reinterpret_cast<Bytef*>(bytes.data()), &made,
               reinterpret_cast<const Bytef*>(numbers.data()), size);
      bytes.resize(made);
    }
    put(out, std::uint32_t{deflate});
    put(out, static_cast<std::uint32_t>(bytes.size()));
    out += bytes;
  }

  void put_value(std::string& out, const FbxOut::Value& value) const {
    if (const auto* narrow = std::get_if<std::int32_t>(&value)) {
      out += 'I';
      put(out, *narrow);
    } else if (const auto* integer = std::get_if<std::int64_t>(&value)) {
      out += 'L';
      put(out, *integer);
    } else if (const auto* real = std::get_if<double>(&value)) {
      out += 'D';
      put(out, *real);
    } else if (const auto* text = std::get_if<std::string>(&value)) {
      // "class::name" is "name, 0, 1, class" here
      const auto colons = text->find("::");
      const std::string bytes =
          colons == std::string::npos
              ? *text
              : text->substr(colons + 2) + std::string("\0\1", 2) + text->substr(0, colons);
      out += 'S';
      put(out, static_cast<std::uint32_t>(bytes.size()));
      out += bytes;
    } else if (const auto* longs = std::get_if<std::vector<std::int64_t>>(&value)) {
      put_array(out, 'l', *longs);
    } else if (const auto* ints = std::get_if<std::vector<std::int32_t>>(&value)) {
      put_array(out, 'i', *ints);
    } else {
      put_array(out, 'f', std::get<std::vector<float>>(value));
    }
  }

  void put_node(std::string& out, const FbxOut& node) const {
    const std::size_t begin = out.size();
    out += std::string(3 * offset_size(), '\0');
    out += static_cast<char>(node.name.size());
    out += node.name;
    const std::size_t values = out.size();
    for (const FbxOut::Value& value : node.values) put_value(out, value);
    put_offset(out, begin + offset_size(), node.values.size());
    put_offset(out, begin + 2 * offset_size(), out.size() - values);
    for (const FbxOut& child : node.children) put_node(out, child);
    if (!node.children.empty()) out += end_of_list();
    put_offset(out, begin, out.size());
  }
};

// ---- an animated chain of joints

struct FbxOutKey {
  double time_s = 0.0;
  float value = 0.0F;
  std::int32_t flags = 0x4;
  float slope = 0.0F, next_slope = 0.0F;  ///< or tension and continuity
  float weight = 1.0F / 3.0F, next_weight = 1.0F / 3.0F;
  float bias = 0.0F;  ///< of TCB keys, in the place of the weights
};
constexpr std::int32_t kFbxHold = 0x2, kFbxLinear = 0x4, kFbxAuto = 0x108, kFbxTcb = 0x208,
                       kFbxUser = 0x408, kFbxWeighted = 0x03000408;

struct FbxOutCurve {
  std::string joint = "Hips";
  std::string property = "Lcl Rotation";
  char axis = 'X';
  std::string layer = "Base";
  std::vector<FbxOutKey> keys = {};
};

inline FbxOut fbx_curve(std::int64_t id, const FbxOutCurve& curve) {
  std::vector<std::int64_t> times;
  std::vector<float> values, data;
  std::vector<std::int32_t> flags, counts;
  for (const FbxOutKey& key : curve.keys) {
    times.push_back(static_cast<std::int64_t>(key.time_s * 46186158000.0 + 0.5));
    values.push_back(key.value);
    flags.push_back(key.flags);
    counts.push_back(1);
    const auto packed = static_cast<std::uint32_t>(key.weight * 1e4F + 0.5F) |
                        static_cast<std::uint32_t>(key.next_weight * 1e4F + 0.5F) << 16;
    const bool tcb = key.flags == kFbxTcb;
    for (const float number :
         {key.slope, key.next_slope, tcb ? key.bias : std::bit_cast<float>(packed), 0.0F}) {
      data.push_back(number);
    }
  }
  return {"AnimationCurve",
          {id, "AnimCurve::", ""},
          {{"Default", {0.0}},
           {"KeyVer", {4008}},
           {"KeyTime", {times}},
           {"KeyValueFloat", {values}},
           {"KeyAttrFlags", {flags}},
           {"KeyAttrDataFloat", {data}},
           {"KeyAttrRefCount", {counts}}}};
}

/// A chain of three joints in centimetres, 30 frames per second, with one take "walk".
inline std::vector<FbxOut> animated_fbx(const std::vector<FbxOutCurve>& curves) {
  using V = std::int64_t;
  const auto property = [](const char* name, const char* type, auto... values) {
    return FbxOut{"P",
                  {std::string(name), std::string(type), std::string(), std::string("A"),
                   FbxOut::Value(values)...}};
  };
  FbxOut objects{"Objects"}, links{"Connections"};
  const auto link = [&](V child, V parent, const std::string& to = {}) {
    FbxOut c{"C", {std::string(to.empty() ? "OO" : "OP"), child, parent}};
    if (!to.empty()) c.values.emplace_back(to);
    links.children.push_back(c);
  };
  std::map<std::string, V> models, layers;
  V id = 1000, parent = 0;
  for (const char* joint : {"Hips", "Spine", "Head"}) {
    models[joint] = ++id;
    objects.children.push_back(
        {"Model",
         {id, std::string("Model::") + joint, std::string("LimbNode")},
         {{"Version", {232}},
          {"Properties70", {}, {property("Lcl Translation", "Lcl Translation", 0.0, 50.0, 0.0)}}}});
    link(id, parent);
    parent = id;
  }
  const V stack = ++id;
  double last_s = 0.0;
  for (const FbxOutCurve& curve : curves) {
    for (const FbxOutKey& key : curve.keys) last_s = std::max(last_s, key.time_s);
  }
  objects.children.push_back(
      {"AnimationStack",
       {stack, std::string("AnimStack::walk"), std::string()},
       {{"Properties70",
         {},
         {property("LocalStart", "KTime", V{0}),
          property("LocalStop", "KTime", static_cast<V>(last_s * 46186158000.0 + 0.5))}}}});
  std::map<std::string, V> groups;
  for (const FbxOutCurve& curve : curves) {
    if (!layers.contains(curve.layer)) {
      layers[curve.layer] = ++id;
      objects.children.push_back({"AnimationLayer",
                                  {id, "AnimLayer::" + curve.layer, std::string()},
                                  {{"Version", {100}}}});
      link(id, stack);
    }
    V& group = groups[curve.layer + curve.joint + curve.property];
    if (group == 0) {
      group = ++id;
      objects.children.push_back({"AnimationCurveNode",
                                  {group, std::string("AnimCurveNode::R"), std::string()},
                                  {{"Version", {100}}}});
      link(group, layers[curve.layer]);
      link(group, models[curve.joint], curve.property);
    }
    objects.children.push_back(fbx_curve(++id, curve));
    link(id, group, std::string("d|") + curve.axis);
  }
  const FbxOut header{
      "FBXHeaderExtension", {}, {{"FBXHeaderVersion", {1003}}, {"FBXVersion", {7400}}}};
  const FbxOut settings{
      "GlobalSettings",
      {},
      {{"Version", {1000}},
       {"Properties70",
        {},
        {property("UpAxis", "int", 1), property("UpAxisSign", "int", 1),
         property("UnitScaleFactor", "double", 1.0), property("TimeMode", "enum", 6)}}}};
  return {header, settings, objects, links};
}

}  // namespace limber::test
