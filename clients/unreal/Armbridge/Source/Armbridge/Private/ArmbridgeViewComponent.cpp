#include "ArmbridgeViewComponent.h"

#include "ArmbridgeComponent.h"
#include "ArmbridgeRobotModel.h"
#include "Components/StaticMeshComponent.h"
#include "Core/Stl.h"
#include "Engine/StaticMesh.h"
#include "GameFramework/Actor.h"
#include "HttpModule.h"
#include "Interfaces/IHttpResponse.h"
#include "Materials/MaterialInstanceDynamic.h"
#include "ProceduralMeshComponent.h"

DEFINE_LOG_CATEGORY_STATIC(LogArmbridgeView, Log, All);

namespace
{
constexpr float TimeoutS = 30.0f;

/** Unreal measures in centimetres. */
constexpr double CmPerM = 100.0;

FVector Vector(const Armbridge::FTriple& Triple)
{
	return FVector(Triple.X, Triple.Y, Triple.Z);
}

FQuat Quaternion(const Armbridge::FRotation& Ros)
{
	const Armbridge::FRotation Turned = Armbridge::MirroredRotation(Ros);
	return FQuat(Turned.X, Turned.Y, Turned.Z, Turned.W);
}

const TCHAR* ShapeAsset(EArmbridgeShape Shape)
{
	switch (Shape)
	{
	case EArmbridgeShape::Cylinder:
		return TEXT("/Engine/BasicShapes/Cylinder.Cylinder");
	case EArmbridgeShape::Sphere:
		return TEXT("/Engine/BasicShapes/Sphere.Sphere");
	default:
		return TEXT("/Engine/BasicShapes/Cube.Cube");
	}
}
}

void UArmbridgeViewComponent::BeginPlay()
{
	Super::BeginPlay();
	Arm = GetOwner()->FindComponentByClass<UArmbridgeComponent>();
	if (!Arm)
	{
		UE_LOG(LogArmbridgeView, Warning, TEXT("the actor has no armbridge component: add one beside this view"));
		return;
	}
	Arm->OnJoints.AddDynamic(this, &UArmbridgeViewComponent::MoveJoints);
	// The port that speaks rosbridge serves the files by HTTP: ws is http, wss is https.
	FString Url = Arm->Url;
	Url.RemoveFromStart(TEXT("ws"));
	Url.RemoveFromEnd(TEXT("/"));
	Url = TEXT("http") + Url + TEXT("/robot/description.urdf");
	Request(Url, [this, Url](const FHttpResponsePtr& Response) { Build(Response->GetContentAsString(), Url); });
}

void UArmbridgeViewComponent::Request(const FString& Url, TFunction<void(const FHttpResponsePtr&)> Then)
{
	const TSharedRef<IHttpRequest, ESPMode::ThreadSafe> File = FHttpModule::Get().CreateRequest();
	File->SetURL(Url);
	File->SetVerb(TEXT("GET"));
	File->SetTimeout(TimeoutS);
	if (!Arm->Token.IsEmpty())
	{
		File->SetHeader(TEXT("Authorization"), TEXT("Bearer ") + Arm->Token);
	}
	// The view may be gone when the answer comes.
	File->OnProcessRequestComplete().BindWeakLambda(this, [Url, Then](FHttpRequestPtr, FHttpResponsePtr Response, bool bCame) {
		if (bCame && Response.IsValid() && Response->GetResponseCode() == 200)
		{
			Then(Response);
		}
		else
		{
			UE_LOG(LogArmbridgeView, Warning, TEXT("%s did not come (%d)"), *Url, Response.IsValid() ? Response->GetResponseCode() : 0);
		}
	});
	File->ProcessRequest();
}

void UArmbridgeViewComponent::Build(const FString& Urdf, const FString& UrdfUrl)
{
	FArmbridgeRobotModel Model;
	FString Error;
	if (!Model.Parse(Urdf, UrdfUrl, Error))
	{
		UE_LOG(LogArmbridgeView, Warning, TEXT("%s cannot be read: %s"), *UrdfUrl, *Error);
		return;
	}
	for (const FString& Name : Model.Links)
	{
		USceneComponent* Link = NewObject<USceneComponent>(GetOwner(), FName(*Name));
		Link->SetupAttachment(this);
		Link->RegisterComponent();
		Links.Add(Name, Link);
	}
	for (const FArmbridgeJoint& Joint : Model.Joints)
	{
		if (!Links.Contains(Joint.Parent) || !Links.Contains(Joint.Child))
		{
			UE_LOG(LogArmbridgeView, Warning, TEXT("joint %s joins links that do not exist"), *Joint.Name);
			continue;
		}
		Links[Joint.Child]->AttachToComponent(Links[Joint.Parent], FAttachmentTransformRules::KeepRelativeTransform);
		Links[Joint.Child]->SetRelativeLocationAndRotation(
			Vector(Armbridge::UnrealFromRos(Joint.Position)), Quaternion(Joint.Rotation));
		Joints.Add(Joint.Name, MakeShared<FArmbridgeJoint>(Joint));
	}
	for (const FArmbridgeVisual& Visual : Model.Visuals)
	{
		Show(Visual);
	}
}

void UArmbridgeViewComponent::MoveJoints(const TArray<FString>& Names, const TArray<float>& PositionsRad)
{
	for (int32 Index = 0; Index < Names.Num(); ++Index)
	{
		const TSharedPtr<FArmbridgeJoint>* Found = Joints.Find(Names[Index]);
		if (!Found)
		{
			continue;
		}
		const FArmbridgeJoint& Joint = **Found;
		const FVector Axis = Vector(Armbridge::MirroredDirection(Joint.Axis));
		FVector Location = Vector(Armbridge::UnrealFromRos(Joint.Position));
		FQuat Rotation = Quaternion(Joint.Rotation);
		if (Joint.bTurns)
		{
			// One mirrored axis turns the angle's sign.
			Rotation = Rotation * FQuat(Axis.GetSafeNormal(), -PositionsRad[Index]);
		}
		else if (Joint.bSlides)
		{
			Location += Rotation.RotateVector(Axis) * PositionsRad[Index] * CmPerM;
		}
		Links[Joint.Child]->SetRelativeLocationAndRotation(Location, Rotation);
	}
}

void UArmbridgeViewComponent::Show(const FArmbridgeVisual& Visual)
{
	if (Visual.Shape == EArmbridgeShape::Mesh)
	{
		Request(Visual.Mesh, [this, Visual](const FHttpResponsePtr& Response) { ShowMesh(Visual, Response->GetContent()); });
		return;
	}
	UStaticMeshComponent* Mesh = NewObject<UStaticMeshComponent>(GetOwner());
	Mesh->SetStaticMesh(LoadObject<UStaticMesh>(nullptr, ShapeAsset(Visual.Shape)));
	// The basic shapes are 1 m wide: their scale is the size in metres.
	Place(Visual, Mesh, Vector(Visual.Size));
}

void UArmbridgeViewComponent::ShowMesh(const FArmbridgeVisual& Visual, const TArray<uint8>& File)
{
	std::vector<float> Corners;
	std::string Error;
	if (!Armbridge::ParseStl(std::vector<uint8_t>(File.GetData(), File.GetData() + File.Num()), Corners, Error))
	{
		UE_LOG(LogArmbridgeView, Warning, TEXT("%s: %s"), *Visual.Mesh, UTF8_TO_TCHAR(Error.c_str()));
		return;
	}
	TArray<FVector> Vertices;
	TArray<int32> Triangles;
	TArray<FVector> Normals;
	for (size_t First = 0; First < Corners.size(); First += 9)
	{
		FVector Three[3];
		for (int32 Corner = 0; Corner < 3; ++Corner)
		{
			const float* At = Corners.data() + First + 3 * Corner;
			Three[Corner] = Vector(
				Armbridge::UnrealFromRos({At[0] * Visual.Size.X, At[1] * Visual.Size.Y, At[2] * Visual.Size.Z}));
		}
		const FVector Normal = FVector::CrossProduct(Three[2] - Three[0], Three[1] - Three[0]).GetSafeNormal();
		for (int32 Corner = 0; Corner < 3; ++Corner)
		{
			// Unreal draws the side on which the corners run counter-clockwise, as STL has them.
			Triangles.Add(Vertices.Num());
			Vertices.Add(Three[Corner]);
			Normals.Add(Normal);
		}
	}
	UProceduralMeshComponent* Mesh = NewObject<UProceduralMeshComponent>(GetOwner());
	Mesh->CreateMeshSection(0, Vertices, Triangles, Normals, {}, {}, {}, false);
	Place(Visual, Mesh, FVector(1.0, 1.0, 1.0));
}

void UArmbridgeViewComponent::Place(const FArmbridgeVisual& Visual, UMeshComponent* Mesh, const FVector& Scale)
{
	UMaterialInterface* Base =
		LoadObject<UMaterialInterface>(nullptr, TEXT("/Engine/BasicShapes/BasicShapeMaterial.BasicShapeMaterial"));
	UMaterialInstanceDynamic* Material = UMaterialInstanceDynamic::Create(Base, Mesh);
	Material->SetVectorParameterValue(TEXT("Color"), Visual.Color);
	Mesh->SetMaterial(0, Material);
	Mesh->SetCollisionEnabled(ECollisionEnabled::NoCollision);
	Mesh->SetupAttachment(Links[Visual.Link]);
	Mesh->SetRelativeLocationAndRotation(Vector(Armbridge::UnrealFromRos(Visual.Position)), Quaternion(Visual.Rotation));
	Mesh->SetRelativeScale3D(Scale);
	Mesh->RegisterComponent();
}
