// The declarations of Unreal Engine that the plugin uses, so that it compiles without the engine. Nothing here does anything.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

using int32 = std::int32_t;
using int64 = std::int64_t;
using uint8 = std::uint8_t;
using TCHAR = char16_t;

#define TEXT(Literal) u##Literal
#define ARMBRIDGE_API
#define UCLASS(...)
#define UPROPERTY(...)
#define UFUNCTION(...)
#define IMPLEMENT_MODULE(Class, Name)
#define DEFINE_LOG_CATEGORY_STATIC(Name, Level, Most) struct F##Name { };
template <typename... T> void LogStandIn(const TCHAR*, T...) { }
#define UE_LOG(Name, Level, ...) do { [[maybe_unused]] F##Name Category; LogStandIn(__VA_ARGS__); } while (false)

template <typename T> struct TArray
{
	std::vector<T> Items;
	TArray() = default;
	int32 Num() const { return static_cast<int32>(Items.size()); }
	void Add(const T& Item) { Items.push_back(Item); }
	T* GetData() { return Items.data(); }
	const T* GetData() const { return Items.data(); }
	T& operator[](int32 Index) { return Items[static_cast<size_t>(Index)]; }
	const T& operator[](int32 Index) const { return Items[static_cast<size_t>(Index)]; }
	auto begin() const { return Items.begin(); }
	auto end() const { return Items.end(); }
};

struct FString
{
	std::u16string Text;
	FString() = default;
	FString(const TCHAR* In) : Text(In) { }
	const TCHAR* operator*() const { return Text.c_str(); }
	bool IsEmpty() const { return Text.empty(); }
	bool RemoveFromStart(const TCHAR*) { return true; }
	bool RemoveFromEnd(const TCHAR*) { return true; }
	int32 ParseIntoArrayWS(TArray<FString>&) const { return 0; }
	bool operator==(const TCHAR* Other) const { return Text == Other; }
	bool operator!=(const TCHAR* Other) const { return Text != Other; }
	bool operator<(const FString& Other) const { return Text < Other.Text; }
};
inline FString operator+(const FString& A, const FString& B) { return FString((A.Text + B.Text).c_str()); }
inline FString operator+(const TCHAR* A, const FString& B) { return FString(A) + B; }
inline FString operator+(const FString& A, const TCHAR* B) { return A + FString(B); }
inline FString operator/(const FString& A, const FString& B) { return A + TEXT("/") + B; }
struct FName { FName(const TCHAR*) { } };
struct FCString { static double Atod(const TCHAR*) { return 0.0; } };
struct FPaths { static FString GetPath(const FString& Path) { return Path; } };
inline const TCHAR* UTF8_TO_TCHAR(const char*) { return TEXT(""); }
inline const char* TCHAR_TO_UTF8(const TCHAR*) { return ""; }

template <typename K, typename V> struct TPair { K Key; V Value; };
template <typename K, typename V> struct TMap
{
	std::vector<TPair<K, V>> Items;
	V& Add(const K&, const V& Value) { Items.push_back({K(), Value}); return Items.back().Value; }
	V& FindOrAdd(const K&) { Items.emplace_back(); return Items.back().Value; }
	V* Find(const K&) { return nullptr; }
	const V* Find(const K&) const { return nullptr; }
	bool Contains(const K&) const { return false; }
	V& operator[](const K&) { return Items.front().Value; }
	void Empty() { Items.clear(); }
	auto begin() { return Items.begin(); }
	auto end() { return Items.end(); }
};

enum class ESPMode { ThreadSafe };
template <typename T, ESPMode M = ESPMode::ThreadSafe> struct TSharedRef
{
	std::shared_ptr<T> Pointer;
	T* operator->() const { return Pointer.get(); }
};
template <typename T, ESPMode M = ESPMode::ThreadSafe> struct TSharedPtr
{
	std::shared_ptr<T> Pointer;
	TSharedPtr() = default;
	TSharedPtr(const TSharedRef<T, M>& Ref) : Pointer(Ref.Pointer) { }
	bool IsValid() const { return Pointer != nullptr; }
	explicit operator bool() const { return IsValid(); }
	void Reset() { Pointer.reset(); }
	TSharedRef<T, M> ToSharedRef() const { return {Pointer}; }
	T* operator->() const { return Pointer.get(); }
	T& operator*() const { return *Pointer; }
};
template <typename T> struct TWeakPtr
{
	TWeakPtr(const TSharedRef<T>&) { }
	TSharedPtr<T> Pin() const { return {}; }
};
template <typename T> struct TSharedFromThis { TSharedRef<T> AsShared() { return {}; } };
template <typename T, typename... A> TSharedRef<T> MakeShared(A&&... Arguments) { return {std::make_shared<T>(std::forward<A>(Arguments)...)}; }
template <typename T> struct TObjectPtr
{
	T* Pointer = nullptr;
	TObjectPtr() = default;
	TObjectPtr(T* In) : Pointer(In) { }
	operator T*() const { return Pointer; }
	T* operator->() const { return Pointer; }
};
template <typename T> using TFunction = std::function<T>;

template <typename... A> struct TDelegateStandIn
{
	template <typename C> void AddSP(C*, void (C::*)(A...)) { }
	template <typename C> void AddUObject(C*, void (C::*)(A...)) { }
	template <typename C> void AddDynamic(C*, void (C::*)(A...)) { }
	template <typename C, typename L> void BindWeakLambda(C*, L Call) { std::function<void(A...)> Checked = Call; }
	void RemoveAll(const void*) { }
	void Broadcast(A...) { }
};
#define DECLARE_DYNAMIC_MULTICAST_DELEGATE_TwoParams(Name, T0, N0, T1, N1) using Name = TDelegateStandIn<T0, T1>
#define DECLARE_MULTICAST_DELEGATE_OneParam(Name, T0) using Name = TDelegateStandIn<T0>

struct FVector
{
	double X = 0.0, Y = 0.0, Z = 0.0;
	FVector() = default;
	FVector(double InX, double InY, double InZ) : X(InX), Y(InY), Z(InZ) { }
	static FVector CrossProduct(const FVector& A, const FVector&) { return A; }
	FVector GetSafeNormal() const { return *this; }
	FVector operator-(const FVector&) const { return *this; }
	FVector operator*(double) const { return *this; }
	void operator+=(const FVector&) { }
};
struct FQuat
{
	double X = 0.0, Y = 0.0, Z = 0.0, W = 1.0;
	FQuat(double InX, double InY, double InZ, double InW) : X(InX), Y(InY), Z(InZ), W(InW) { }
	FQuat(const FVector&, double) { }
	FQuat operator*(const FQuat&) const { return *this; }
	FVector RotateVector(const FVector& Vector) const { return Vector; }
};
struct FRotator { FQuat Quaternion() const { return FQuat(0.0, 0.0, 0.0, 1.0); } };
struct FVector2D { };
struct FColor { };
struct FProcMeshTangent { };
struct FLinearColor { FLinearColor() = default; FLinearColor(float, float, float, float) { } };
struct FDateTime
{
	static FDateTime UtcNow() { return {}; }
	int64 ToUnixTimestamp() const { return 0; }
	int32 GetMillisecond() const { return 0; }
};
using FTickerDelegateCall = std::function<bool(float)>;
struct FTickerDelegate { static FTickerDelegateCall CreateLambda(FTickerDelegateCall Call) { return Call; } };
struct FTSTicker
{
	struct FDelegateHandle { };
	static FTSTicker& GetCoreTicker() { static FTSTicker Ticker; return Ticker; }
	FDelegateHandle AddTicker(FTickerDelegateCall, float) { return {}; }
	void RemoveTicker(FDelegateHandle) { }
};

struct FDefaultModuleImpl { };
struct UObject { };
template <typename T> T* NewObject(UObject*, FName = FName(TEXT(""))) { return nullptr; }
template <typename T> T* LoadObject(UObject*, const TCHAR*) { return nullptr; }
struct UGameInstance : UObject { template <typename T> T* GetSubsystem() { return nullptr; } };
struct UGameInstanceSubsystem : UObject { virtual ~UGameInstanceSubsystem() = default; virtual void Deinitialize() { } };
struct UWorld { UGameInstance* GetGameInstance() { return nullptr; } };
namespace EEndPlayReason { enum Type { Quit }; }
struct AActor : UObject { template <typename T> T* FindComponentByClass() { return nullptr; } };
struct UActorComponent : UObject
{
	virtual ~UActorComponent() = default;
	virtual void BeginPlay() { }
	virtual void EndPlay(const EEndPlayReason::Type) { }
	UWorld* GetWorld() const { return nullptr; }
	AActor* GetOwner() const { return nullptr; }
	void RegisterComponent() { }
};
struct FAttachmentTransformRules { static inline const int KeepRelativeTransform = 0; };
struct USceneComponent : UActorComponent
{
	void SetupAttachment(USceneComponent*) { }
	bool AttachToComponent(USceneComponent*, int) { return true; }
	void SetRelativeLocationAndRotation(const FVector&, const FQuat&) { }
	void SetRelativeScale3D(const FVector&) { }
};
struct UMaterialInterface : UObject { };
struct UMaterialInstanceDynamic : UMaterialInterface
{
	static UMaterialInstanceDynamic* Create(UMaterialInterface*, UObject*) { return nullptr; }
	void SetVectorParameterValue(FName, const FLinearColor&) { }
};
enum class ECollisionEnabled { NoCollision };
struct UMeshComponent : USceneComponent
{
	void SetMaterial(int32, UMaterialInterface*) { }
	void SetCollisionEnabled(ECollisionEnabled) { }
};
struct UStaticMesh : UObject { };
struct UStaticMeshComponent : UMeshComponent { bool SetStaticMesh(UStaticMesh*) { return true; } };
struct UProceduralMeshComponent : UMeshComponent
{
	void CreateMeshSection(
		int32, const TArray<FVector>&, const TArray<int32>&, const TArray<FVector>&, const TArray<FVector2D>&,
		const TArray<FColor>&, const TArray<FProcMeshTangent>&, bool) { }
};

struct IWebSocket
{
	TDelegateStandIn<>& OnConnected() { static TDelegateStandIn<> Event; return Event; }
	TDelegateStandIn<const FString&>& OnConnectionError() { static TDelegateStandIn<const FString&> Event; return Event; }
	TDelegateStandIn<int32, const FString&, bool>& OnClosed() { static TDelegateStandIn<int32, const FString&, bool> Event; return Event; }
	TDelegateStandIn<const FString&>& OnMessage() { static TDelegateStandIn<const FString&> Event; return Event; }
	void Connect() { }
	bool IsConnected() const { return false; }
	void Send(const FString&) { }
	void Close() { }
};
struct FWebSocketsModule
{
	static FWebSocketsModule& Get() { static FWebSocketsModule Module; return Module; }
	TSharedRef<IWebSocket> CreateWebSocket(const FString&) { return {}; }
};

struct IHttpResponse
{
	int32 GetResponseCode() const { return 0; }
	FString GetContentAsString() const { return {}; }
	const TArray<uint8>& GetContent() const { static TArray<uint8> Content; return Content; }
};
struct IHttpRequest;
using FHttpRequestPtr = TSharedPtr<IHttpRequest>;
using FHttpResponsePtr = TSharedPtr<IHttpResponse>;
struct IHttpRequest
{
	void SetURL(const FString&) { }
	void SetVerb(const FString&) { }
	void SetTimeout(float) { }
	void SetHeader(const FString&, const FString&) { }
	TDelegateStandIn<FHttpRequestPtr, FHttpResponsePtr, bool>& OnProcessRequestComplete()
	{
		static TDelegateStandIn<FHttpRequestPtr, FHttpResponsePtr, bool> Event;
		return Event;
	}
	bool ProcessRequest() { return true; }
};
struct FHttpModule
{
	static FHttpModule& Get() { static FHttpModule Module; return Module; }
	TSharedRef<IHttpRequest> CreateRequest() { return {}; }
};

enum class EConstructMethod { ConstructFromBuffer };
struct FXmlNode
{
	FString GetTag() const { return {}; }
	FString GetAttribute(const FString&) const { return {}; }
	const FXmlNode* GetFirstChildNode() const { return nullptr; }
	const FXmlNode* FindChildNode(const FString&) const { return nullptr; }
	const TArray<FXmlNode*>& GetChildrenNodes() const { static TArray<FXmlNode*> Children; return Children; }
};
struct FXmlFile
{
	FXmlFile(const FString&, EConstructMethod) { }
	bool IsValid() const { return false; }
	FString GetLastError() const { return {}; }
	const FXmlNode* GetRootNode() const { return nullptr; }
};
